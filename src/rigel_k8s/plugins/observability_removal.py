"""The stack taken off a cluster; its data stay, and the password that opens them."""

from __future__ import annotations

import threading

from rigel_k8s.deploy.release import down
from rigel_k8s.deploy.types import Plan, ReleaseId
from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.manifests.observability.names import RELEASE
from rigel_k8s.plugins.observability_found import installed_in
from rigel_k8s.plugins.observability_password import administrator_ref
from rigel_k8s.plugins.observability_wanted import NAMESPACE
from rigel_k8s.report import Reporter

__all__ = ["remove"]


def remove(
    cluster: Cluster,
    report: Reporter,
    cancel: threading.Event | None = None,
    *,
    volumes: bool,
    namespace: str | None = None,
    timeout: float | None = None,
) -> Plan:
    """Delete the stack's objects and its history; its namespace stays.

    Args:
        volumes: its data go too, and Grafana's password.
        namespace: where it was, for data of a stack that is gone; None looks for the stack.
        timeout: seconds that the end of its pods may take.

    Raises:
        UserError: there is no stack.
    """
    where = namespace or installed_in(cluster) or NAMESPACE
    plan = down(
        cluster,
        ReleaseId(where, RELEASE),
        volumes=volumes,
        report=report,
        cancel=cancel,
        timeout=timeout,
    )
    if volumes:
        cluster.delete(administrator_ref(where))
    if not plan.steps:
        raise UserError(
            f"there is no observability stack in the namespace {where}",
            hint="-n NAMESPACE, if its data are elsewhere; --context NAME, if it is",
        )
    return plan

"""Removes the stack from a cluster; its data stay, and Grafana's password."""

from __future__ import annotations

import threading
import time
from contextlib import suppress

from rigel_k8s.commands.interruption import writing
from rigel_k8s.deploy import down
from rigel_k8s.errors import UserError
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.objects.naming import selector
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.names import NAMESPACE, RELEASE
from rigel_k8s.observability.reading.stack import NoStack, find_namespace, find_stack
from rigel_k8s.release.survey import belongs
from rigel_k8s.release.types import DeployOptions, Plan, ReleaseId
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings
from rigel_stack.manifests.otelcollector import OTEL_COLLECTOR
from rigel_stack.manifests.promtail import PROMTAIL
from rigel_stack.password import administrator_ref

LOOK = 0.5
#: Seconds in which a collector can send what it has read.
HAND_OVER = 30.0
COLLECTORS = (OTEL_COLLECTOR, PROMTAIL)


def remove_installed(
    settings: Settings, report: Reporter, *, volumes: bool
) -> tuple[ReleaseId, int, int]:
    """Remove the stack; return its release, and how many objects were deleted and how many stayed.

    Args:
        volumes: delete its data too.

    Raises:
        NoStack: neither a stack nor its data exist.
    """
    cluster = connect(settings)
    with writing(cluster, settings, report) as options:
        namespace = settings.namespace
        with suppress(NoStack):  # its data may still exist
            namespace = find_stack(cluster, namespace).namespace
        plan = remove(cluster, options, volumes=volumes, namespace=namespace)
    counts = [sum(step.action == action for step in plan.steps) for action in ("prune", "forget")]
    return plan.release, counts[0], counts[1]


def remove(
    cluster: Cluster,
    options: DeployOptions,
    *,
    volumes: bool,
    namespace: str | None = None,
) -> Plan:
    """Delete the stack's objects and its history; its namespace stays.

    Args:
        volumes: delete its data too, and Grafana's password.
        namespace: that of the data of a removed stack; None looks for the stack.

    Raises:
        UserError: there is no stack.
    """
    where = namespace or find_namespace(cluster) or NAMESPACE
    _stop_collecting(cluster, where, options.report, options.cancel)
    plan = down(cluster, ReleaseId(where, RELEASE), options, volumes=volumes)
    if volumes:
        cluster.delete(administrator_ref(where))
    if plan.is_empty:
        raise UserError(
            f"there is no observability stack in the namespace {where}",
            hint="pass -n NAMESPACE if its data are in another one, or --context NAME",
        )
    return plan


def _stop_collecting(
    cluster: Cluster, namespace: str, report: Reporter, cancel: threading.Event
) -> None:
    """End the collector while Loki still runs and can take its last lines."""
    for name in COLLECTORS:
        ref = ObjectRef("apps/v1", "DaemonSet", namespace, name)
        live = cluster.get(ref)
        if live is None or not belongs(live, ReleaseId(namespace, RELEASE)):
            continue
        cluster.delete(ref, uid=live["metadata"]["uid"])
        report.progress(name, "sends its last lines")
        end = time.monotonic() + HAND_OVER
        while cluster.list("v1", "Pod", namespace, labels=selector(name)):
            if time.monotonic() > end or cancel.wait(LOOK):
                break
        report.progress(name, "removed", done=True)

"""Multus and whereabouts taken off a cluster so that every node goes on starting pods.

In this order: the pods on the machines are told to take their configuration away, so that new pods
get the cluster's own network and nothing else; when that is so on every node, the objects go, and
the programs with the last pods.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.install import installation_of
from rigel_k8s.network.multus.installation import Found, complete_options, find
from rigel_k8s.network.multus.interfaces import list_asked
from rigel_k8s.network.multus.proving import forget
from rigel_k8s.network.multus.rollout import find_release
from rigel_k8s.network.options import Install
from rigel_k8s.release.deploy import deploy
from rigel_k8s.release.removal import down
from rigel_k8s.release.types import Desired
from rigel_k8s.report import Reporter

Object = Mapping[str, Any]


@attrs.frozen
class Removed:
    """What was done.

    Attributes:
        count: objects that were deleted.
        away: nodes that were not there to be cleaned.
        kept: whether the definitions, and with them all attachments, are still there.
    """

    count: int
    away: tuple[str, ...]
    kept: bool


def remove(
    cluster: Cluster,
    options: Install,
    report: Reporter,
    cancel: threading.Event | None = None,
    *,
    force: bool = False,
    definitions: bool = False,
    timeout: float | None = None,
) -> Removed:
    """Take away what install() has made.

    Args:
        force: though pods have second networks, or nodes are away.
        definitions: delete the kinds too, and with them every NetworkAttachmentDefinition.

    Raises:
        UserError: Multus is another's, pods are attached, or a node is away.
        RolloutFailed: a node does not give its configuration back.
    """
    cancel = cancel or threading.Event()
    options = complete_options(cluster, options)
    found = find(cluster, options)
    _refuse(cluster, found, report, force=force)
    installation = installation_of(found, options, retired=True)
    _retire(cluster, find_release(cluster, installation, found), found, report, cancel, timeout)
    forget(cluster)
    plan = down(
        cluster, RELEASE, volumes=definitions, report=report, cancel=cancel, timeout=timeout
    )
    count = sum(1 for step in plan.steps if step.action == "prune")
    return Removed(count, found.away, kept=not definitions)


def users(cluster: Cluster) -> list[Object]:
    """Return the pods that have, or are getting, a second network."""
    return [pod for pod in cluster.list("v1", "Pod") if list_asked(pod) and not _is_over(pod)]


def _is_over(pod: Object) -> bool:
    host = bool(pod.get("spec", {}).get("hostNetwork"))
    return host or pod.get("status", {}).get("phase") in ("Succeeded", "Failed")


def _refuse(cluster: Cluster, found: Found, report: Reporter, *, force: bool) -> None:
    """Raise where a removal would hurt, or only say so where it is forced."""
    if found.multus and not found.multus.ours:
        raise UserError(
            f"Multus ({found.multus.where}) was not installed by rigel",
            hint="remove it with what has installed it",
        )
    attached = [f"{p['metadata']['namespace']}/{p['metadata']['name']}" for p in users(cluster)]
    reasons = [f"pod {name} has a second network" for name in sorted(attached)]
    reasons += [f"node {name} is away and keeps Multus' configuration" for name in found.away]
    if reasons and not force:
        raise UserError(
            "Multus is in use: nothing was removed",
            hint="take those applications down first, or say --force",
            details=reasons,
        )
    for reason in reasons:
        report.warn(reason)


def _retire(
    cluster: Cluster,
    desired: Desired,
    found: Found,
    report: Reporter,
    cancel: threading.Event,
    timeout: float | None,
) -> None:
    """Have the machines give their configuration back."""
    deploy(
        desired,
        cluster,
        report=report,
        cancel=cancel,
        timeout=timeout,
        adopt=True,
        description="network: about to be removed",
        away=found.away,
    )
    if found.away:
        report.warn(_describe_left(found.away))


def _describe_left(away: Sequence[str]) -> str:
    names = ", ".join(away)
    return (
        f"{names} can start no pods when it is back, until `rigel network install` or"
        " `rigel network remove` is run again"
    )

"""Removes Multus and whereabouts from a cluster; every machine continues to start pods.

First the pods on the machines remove their configuration, so new pods get only the cluster's own
network. After that has happened on every machine, the objects are deleted; the last pods remove the
programs when they end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.install import find_release, installation_of
from rigel_k8s.network.multus.installation import Found, complete_options, find
from rigel_k8s.network.multus.interfaces import list_asked
from rigel_k8s.network.multus.proving import forget
from rigel_k8s.network.options import Install
from rigel_k8s.release.deploy import deploy
from rigel_k8s.release.removal import down
from rigel_k8s.release.types import DeployOptions, Desired
from rigel_k8s.report import Reporter

Object = Mapping[str, Any]


@attrs.frozen
class Removed:
    """The result of a removal.

    Attributes:
        count: how many objects were deleted.
        away: machines that were unreachable and so were not cleaned.
        kept: whether the definitions, and with them all attachments, still exist.
    """

    count: int
    away: tuple[str, ...]
    kept: bool


def remove(
    cluster: Cluster,
    requested: Install,
    options: DeployOptions,
    *,
    force: bool = False,
    definitions: bool = False,
) -> Removed:
    """Remove what install() has installed.

    Args:
        force: remove even if pods have second networks or machines are unreachable.
        definitions: delete the kinds too, and with them every NetworkAttachmentDefinition.

    Raises:
        UserError: others installed Multus, pods are attached, or a machine is unreachable.
        RolloutFailed: the configuration of a machine is not removed.
    """
    complete = complete_options(cluster, requested)
    found = find(cluster, complete)
    _refuse(cluster, found, options.report, force=force)
    installation = installation_of(found, complete, retired=True)
    _retire(cluster, find_release(cluster, installation, found), found, options)
    forget(cluster)
    plan = down(cluster, RELEASE, options, volumes=definitions)
    count = sum(1 for step in plan.steps if step.action == "prune")
    return Removed(count, found.away, kept=not definitions)


def users(cluster: Cluster) -> list[Object]:
    """Return the pods that have, or are getting, a second network."""
    return [pod for pod in cluster.list("v1", "Pod") if list_asked(pod) and not _is_over(pod)]


def _is_over(pod: Object) -> bool:
    host = bool(pod.get("spec", {}).get("hostNetwork"))
    return host or pod.get("status", {}).get("phase") in ("Succeeded", "Failed")


def _refuse(cluster: Cluster, found: Found, report: Reporter, *, force: bool) -> None:
    """Raise an error if a removal would do harm; only warn if it is forced."""
    if found.multus and not found.multus.ours:
        raise UserError(
            f"Multus ({found.multus.where}) was not installed by rigel",
            hint="remove it with the tool that installed it",
        )
    attached = [f"{p['metadata']['namespace']}/{p['metadata']['name']}" for p in users(cluster)]
    reasons = [f"pod {name} has a second network" for name in sorted(attached)]
    reasons += [
        f"machine {name} is unreachable and keeps Multus' configuration" for name in found.away
    ]
    if reasons and not force:
        raise UserError(
            "Multus is in use: nothing was removed",
            hint="take those applications down first, or pass --force",
            details=reasons,
        )
    for reason in reasons:
        report.warn(reason)


def _retire(cluster: Cluster, desired: Desired, found: Found, options: DeployOptions) -> None:
    """Have the pods on the machines remove their configuration."""
    retiring = attrs.evolve(options, adopt=True, description="network: about to be removed")
    deploy(desired, cluster, retiring, away=found.away)
    if found.away:
        options.report.warn(_describe_left(found.away))


def _describe_left(away: Sequence[str]) -> str:
    names = ", ".join(away)
    return (
        f"after it is back, {names} cannot start pods until you run `rigel network install` or"
        " `rigel network remove` again"
    )

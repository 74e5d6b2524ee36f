"""Removes Multus and whereabouts from a cluster; every machine continues to start pods.

First the pods on the machines remove their configuration, so new pods get only the cluster's own
network. After that has happened on every machine, the objects are deleted; the last pods remove the
programs when they end.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.deploy import down, write_release
from rigel_k8s.errors import UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.options import Install
from rigel_k8s.release.part import Part, Run
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter
from rigel_multus.install import find, find_release
from rigel_multus.installation import RELEASE, Installation
from rigel_multus.interfaces import requests_of
from rigel_multus.proving import forget

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
    installation = attrs.evolve(find(cluster, requested), retired=True)
    check_use(cluster, installation, options.report, force=force)
    retiring = attrs.evolve(options, adopt=True, description="network: about to be removed")
    part = Part(desired=find_release(cluster, installation), away=installation.away)
    write_release(Run(cluster=cluster, part=part, options=retiring))
    if installation.away:
        options.report.warn(
            f"after it is back, {', '.join(installation.away)} cannot start pods until you run"
            " `rigel network install` or `rigel network remove` again"
        )
    forget(cluster)
    plan = down(cluster, RELEASE, options, volumes=definitions)
    count = sum(1 for step in plan.steps if step.action == "prune")
    return Removed(count, installation.away, kept=not definitions)


def check_use(
    cluster: Cluster, installation: Installation, report: Reporter, *, force: bool
) -> None:
    """Raise an error if a removal would do harm; only warn if it is forced."""
    multus = installation.parts.get("multus")
    if multus and not multus.ours:
        raise UserError(
            f"Multus ({multus.where}) was not installed by rigel",
            hint="remove it with the tool that installed it",
        )
    attached = [f"{p['metadata']['namespace']}/{p['metadata']['name']}" for p in users(cluster)]
    reasons = [f"pod {name} has a second network" for name in sorted(attached)]
    reasons += [
        f"machine {name} is unreachable and keeps Multus' configuration"
        for name in installation.away
    ]
    if reasons and not force:
        raise UserError(
            "Multus is in use: nothing was removed",
            hint="take those applications down first, or pass --force",
            details=reasons,
        )
    for reason in reasons:
        report.warn(reason)


def users(cluster: Cluster) -> list[Object]:
    """Return the pods that have, or are getting, a second network."""
    return [pod for pod in cluster.list("v1", "Pod") if requests_of(pod) and not is_over(pod)]


def is_over(pod: Object) -> bool:
    """Return whether a pod has ended, or is on its machine's own network."""
    host = bool(pod.get("spec", {}).get("hostNetwork"))
    return host or pod.get("status", {}).get("phase") in ("Succeeded", "Failed")

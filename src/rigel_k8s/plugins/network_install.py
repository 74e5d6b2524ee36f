"""Multus and whereabouts put onto a cluster, until every node of it has attached a pod.

What others have installed is used as it is. A node that is away is not waited for: it gets its
pods when it is back.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Mapping
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s.deploy.release import DEFAULT_TIMEOUT, deploy, diff
from rigel_k8s.deploy.types import RELEASE_LABEL, ref_of
from rigel_k8s.errors import ClusterError, Interrupted, RolloutFailed
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.manifests.multus import RELEASE
from rigel_k8s.manifests.multus.release import Installation, network_release
from rigel_k8s.manifests.network.options import Install, Network
from rigel_k8s.plugins.network_found import Found, Part, find
from rigel_k8s.plugins.network_proof import fingerprint, prove, proven, remember
from rigel_k8s.report import Reporter

if TYPE_CHECKING:
    from rigel_k8s.plugins.orchestration_release import Preparation
    from rigel_k8s.sequences.job import JobContext

__all__ = [
    "Installed",
    "ensure",
    "install",
    "installation_of",
    "is_ready",
    "machine_script",
    "marks_of",
    "told",
    "wanted",
]

Object = Mapping[str, Any]

LOOK = 1.0
#: Seconds for a roll-out where a node is away: it cannot end, and the others are quick.
WITHOUT_ALL = 60.0


@attrs.frozen
class Installed:
    """What was done.

    Attributes:
        nodes: those that attach pods.
        away: those that are not up and were not asked.
        multus: where Multus is, NAMESPACE/NAME.
        ours: whether it is the one that this program installs.
    """

    nodes: tuple[str, ...]
    away: tuple[str, ...]
    multus: str
    ours: bool


def ensure(prepared: Preparation, cluster: Cluster, job: JobContext) -> None:
    """Install what a job's network wants installed; nothing where it does not.

    Raises: as install.
    """
    options = wanted(prepared.options.network)
    if options is not None:
        install(cluster, options, job.report, job.cancel, timeout=job.settings.timeout)


def wanted(network: Network | str | None) -> Install | None:
    """Return what a network wants installed: only what Multus attaches does."""
    if not isinstance(network, Network) or not network.install:
        return None
    if network.mode not in ("macvlan", "ipvlan", "attachment"):
        return None
    return network.install if isinstance(network.install, Install) else Install()


def install(
    cluster: Cluster,
    options: Install,
    report: Reporter,
    cancel: threading.Event | None = None,
    *,
    timeout: float | None = None,
    adopt: bool = False,
) -> Installed:
    """Install or update Multus and whereabouts, and prove that each node attaches pods.

    Nothing is written where all is as it shall be and every node has shown it before.

    Raises:
        ClusterError: a node cannot attach; the causes are in the details.
        RolloutFailed, ConflictError, Refused: as deploy.
        Interrupted: `cancel` was set.
    """
    cancel = cancel or threading.Event()
    found = _found(cluster, options)
    installation = installation_of(found, options)
    _tell_others(found, report)
    for name in found.away:
        report.warn(f"node {name} is not ready: it is not waited for")
    if installation.multus or installation.whereabouts:
        _deploy(cluster, installation, found, report, cancel, timeout=timeout, adopt=adopt)
        _until_ready(cluster, found, installation, report, cancel, timeout or DEFAULT_TIMEOUT)
    return _proved(cluster, options, report, cancel)


def _found(cluster: Cluster, options: Install) -> Found:
    """Look at the cluster, which wants rights that an application's deploy does not."""
    try:
        return find(cluster, options)
    except ClusterError as error:
        if getattr(error, "status", 0) == 403:
            error.hint = (
                "`rigel network install` by an administrator, once; then leave `install` out"
            )
        raise


def installation_of(found: Found, options: Install, *, retired: bool = False) -> Installation:
    """Return what is to be installed: what others have brought is left to them."""
    return Installation(
        found.groups,
        options,
        multus=found.multus is None or found.multus.ours,
        whereabouts=found.whereabouts is None or found.whereabouts.ours,
        there=found.definitions,
        retired=retired,
    )


def machine_script() -> str:
    """Return the text of machine.sh."""
    return (files("rigel_k8s.manifests.multus") / "machine.sh").read_text(encoding="utf-8")


def _tell_others(found: Found, report: Reporter) -> None:
    for name, part in (("Multus", found.multus), ("whereabouts", found.whereabouts)):
        if part and not part.ours:
            report.line(f"{name} is there already ({part.where}, {part.image}): used as it is")


def _deploy(
    cluster: Cluster,
    installation: Installation,
    found: Found,
    report: Reporter,
    cancel: threading.Event,
    *,
    timeout: float | None,
    adopt: bool,
) -> None:
    """Apply what differs; what only nodes that are away keep from being ready is no failure."""
    desired = network_release(installation, machine_script())
    if not diff(desired, cluster, adopt=adopt).changes:
        return
    bound = min(timeout or DEFAULT_TIMEOUT, WITHOUT_ALL) if found.away else timeout
    _let_be_away(cluster, found)
    try:
        deploy(
            desired,
            cluster,
            report=report,
            cancel=cancel,
            timeout=bound,
            adopt=adopt,
            description="network",
        )
    except RolloutFailed:
        if not found.away or list(_unready(cluster, found, installation)):
            raise


def _let_be_away(cluster: Cluster, found: Found) -> None:
    """Let a roll-out go on though nodes are away: Kubernetes would wait for them first."""
    rolling = {"rollingUpdate": {"maxUnavailable": 1 + len(found.away)}}
    for part in (found.multus, found.whereabouts):
        for one in part.sets if found.away and part and part.ours else ():
            cluster.patch(ref_of(one), {"spec": {"updateStrategy": rolling}})


def _until_ready(
    cluster: Cluster,
    found: Found,
    installation: Installation,
    report: Reporter,
    cancel: threading.Event,
    timeout: float,
) -> None:
    """Wait until both parts' pods are ready on all nodes that are up."""
    end = time.monotonic() + timeout
    while waiting := list(_unready(cluster, found, installation)):
        if time.monotonic() > end:
            raise RolloutFailed(
                f"the network is not ready on every node within {timeout:g} s",
                hint=f"kubectl -n {RELEASE.namespace} get pods -l {RELEASE_LABEL}={RELEASE.name}",
                details=waiting,
            )
        report.progress("network", waiting[0])
        if cancel.wait(LOOK):
            raise Interrupted("interrupted while the network was being installed")


def _unready(cluster: Cluster, found: Found, installation: Installation) -> Iterable[str]:
    """Yield what is not ready, and not new, on the nodes that are up."""
    labels = {RELEASE_LABEL: RELEASE.name}
    for one in cluster.list("apps/v1", "DaemonSet", RELEASE.namespace, labels=labels):
        status = one.get("status", {})
        wanted = status.get("desiredNumberScheduled", 0) - len(found.away)
        if status.get("updatedNumberScheduled", 0) < wanted:
            yield f"not all pods of {one['metadata']['name']} are new"
    pods = cluster.list("v1", "Pod", RELEASE.namespace, labels=labels)
    ready = {(pod["spec"].get("nodeName"), _part_of(pod)) for pod in pods if is_ready(pod)}
    parts = [("multus", installation.multus), ("whereabouts", installation.whereabouts)]
    for node in found.up:
        for part, ours in parts:
            if ours and (node, part) not in ready:
                yield f"{part} is not ready on {node}"


def _part_of(pod: Object) -> str:
    name = str((pod["metadata"].get("labels") or {}).get("app.kubernetes.io/name", ""))
    is_reconciler = name.endswith("reconciler")
    return "" if is_reconciler else "multus" if name.startswith("rigel-multus") else "whereabouts"


def is_ready(pod: Object) -> bool:
    """Return whether a pod is ready and stays."""
    conditions = pod.get("status", {}).get("conditions", [])
    met = any(c["type"] == "Ready" and c["status"] == "True" for c in conditions)
    return met and not pod["metadata"].get("deletionTimestamp")


def _proved(
    cluster: Cluster, options: Install, report: Reporter, cancel: threading.Event
) -> Installed:
    """Let those nodes attach a pod that have not shown it before."""
    found = find(cluster, options)
    if found.multus is None:
        raise ClusterError("Multus was removed while it was being installed")
    marks = marks_of(found)
    new = sorted(marks.keys() - proven(cluster, marks))
    failed = prove(cluster, new, found.multus.image, report, cancel) if new else {}
    if new:
        remember(cluster, {node: mark for node, mark in marks.items() if node not in failed})
    _tell_failures(failed, found.multus, report)
    good = tuple(node for node in marks if node not in failed)
    return Installed(good, found.away, found.multus.where, found.multus.ours)


def marks_of(found: Found) -> dict[str, str]:
    """Return what a proof holds for now, by node that is up."""
    parts = [part for part in (found.multus, found.whereabouts) if part]
    sets = [one for part in parts for one in part.sets]
    up = set(found.up)
    nodes = [node for node in found.nodes if node["metadata"]["name"] in up]
    return {node["metadata"]["name"]: fingerprint(node, sets) for node in nodes}


def told(done: Installed) -> str:
    """Return what was done as one line."""
    names = ", ".join(done.nodes) or "no node"
    away = f"; not asked, since away: {', '.join(done.away)}" if done.away else ""
    return f"Multus ({done.multus}) attaches pods on {names}{away}"


def _tell_failures(failed: Mapping[str, str], multus: Part, report: Reporter) -> None:
    """Raise where our own Multus cannot attach; another's is only told."""
    lines = [f"{node}: {told}" for node, told in sorted(failed.items())]
    if not lines:
        return
    if not multus.ours:
        for line in lines:
            report.warn(f"Multus ({multus.where}) attaches no pod on {line}")
        return
    raise ClusterError(
        f"{len(lines)} node(s) cannot attach pods to a second network",
        hint=f"kubectl -n {RELEASE.namespace} logs daemonset/rigel-multus -c multus",
        details=lines,
    )

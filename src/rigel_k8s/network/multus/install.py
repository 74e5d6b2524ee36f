"""Multus and whereabouts put onto a cluster, until every node of it has attached a pod.

What others have installed is used as it is. A node that is away is not waited for: it gets its
pods when it is back.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.desired import Installation
from rigel_k8s.network.multus.installation import Found, MultusPart, complete_options, find
from rigel_k8s.network.multus.proving import find_proven, fingerprint, prove, remember
from rigel_k8s.network.multus.rollout import Rollout
from rigel_k8s.network.options import Install, Network
from rigel_k8s.report import Reporter


@attrs.frozen
class MultusResult:
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


def install_wanted_by(network: Network | None) -> Install | None:
    """Return what a network wants installed: only what Multus attaches does."""
    if network is None or network.install is None or not mode_of(network).attached:
        return None
    said = network.install
    if network.ipam == "dhcp" and said.dhcp is None:
        return attrs.evolve(said, dhcp=True)
    return said


def install(
    cluster: Cluster,
    options: Install,
    report: Reporter,
    cancel: threading.Event | None = None,
    *,
    timeout: float | None = None,
    adopt: bool = False,
) -> MultusResult:
    """Install or update Multus and whereabouts, and prove that each node attaches pods.

    Nothing is written where all is as it shall be and every node has shown it before.

    Raises:
        ClusterError: a node cannot attach; the causes are in the details.
        RolloutFailed, ConflictError, Refused: as deploy.
        Interrupted: `cancel` was set.
    """
    cancel = cancel or threading.Event()
    options, found = _look(cluster, options)
    installation = installation_of(found, options)
    _tell_others(found, report)
    for name in found.away:
        report.warn(f"node {name} is not ready: it is not waited for")
    if installation.multus or installation.whereabouts:
        Rollout(cluster, installation, found, report, cancel, timeout, adopt).run()
    return _prove_nodes(cluster, options, report, cancel)


def _look(cluster: Cluster, said: Install) -> tuple[Install, Found]:
    """Look at the cluster, which wants rights that an application's deploy does not."""
    try:
        options = complete_options(cluster, said)
        return options, find(cluster, options)
    except Forbidden as error:
        error.hint = "`rigel network install` by an administrator, once; then leave `install` out"
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


def _tell_others(found: Found, report: Reporter) -> None:
    for name, part in (("Multus", found.multus), ("whereabouts", found.whereabouts)):
        if part and not part.ours:
            report.line(f"{name} is there already ({part.where}, {part.image}): used as it is")


def _prove_nodes(
    cluster: Cluster, options: Install, report: Reporter, cancel: threading.Event
) -> MultusResult:
    """Let those nodes attach a pod that have not shown it before."""
    found = find(cluster, options)
    if found.multus is None:
        raise ClusterError("Multus was removed while it was being installed")
    marks = marks_of(found)
    new = sorted(marks.keys() - find_proven(cluster, marks))
    failed = prove(cluster, new, found.multus.image, report, cancel) if new else {}
    if new:
        remember(cluster, {node: mark for node, mark in marks.items() if node not in failed})
    _tell_failures(failed, found.multus, report)
    good = tuple(node for node in marks if node not in failed)
    return MultusResult(good, found.away, found.multus.where, found.multus.ours)


def marks_of(found: Found) -> dict[str, str]:
    """Return what a proof holds for now, by node that is up."""
    parts = [part for part in (found.multus, found.whereabouts) if part]
    sets = [one for part in parts for one in part.sets]
    up = set(found.up)
    nodes = [node for node in found.nodes if node["metadata"]["name"] in up]
    return {node["metadata"]["name"]: fingerprint(node, sets) for node in nodes}


def describe(done: MultusResult) -> str:
    """Return what was done as one line."""
    names = ", ".join(done.nodes) or "no node"
    away = f"; not asked, since away: {', '.join(done.away)}" if done.away else ""
    return f"Multus ({done.multus}) attaches pods on {names}{away}"


def _tell_failures(failed: Mapping[str, str], multus: MultusPart, report: Reporter) -> None:
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

"""Installs Multus and whereabouts on a cluster, and waits until every machine has attached a pod.

An installation by others is used unchanged. An unreachable machine is not waited for: it gets its
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
from rigel_k8s.release.types import DeployOptions
from rigel_k8s.report import Reporter


@attrs.frozen
class MultusResult:
    """The result of an installation.

    Attributes:
        nodes: machines that attach pods.
        away: machines that are unreachable and were not tried.
        multus: Multus' DaemonSet, NAMESPACE/NAME.
        ours: whether it was installed by this program.
    """

    nodes: tuple[str, ...]
    away: tuple[str, ...]
    multus: str
    ours: bool


def install_requested_by(network: Network | None) -> Install | None:
    """Return the installation that a network requests; only modes with Multus can."""
    if network is None or network.install is None or not mode_of(network).attached:
        return None
    return network.install


def ensure(cluster: Cluster, requested: Install, options: DeployOptions) -> None:
    """Install what an application's job requests.

    With rights only for applications, it prints a warning and uses the cluster as it is. `adopt`
    is meant for the application's objects, not for those in kube-system.

    Raises: as install.
    """
    try:
        install(cluster, requested, attrs.evolve(options, adopt=False))
    except Forbidden as error:
        if error.ground != "right":
            raise
        options.report.warn(f"{error.message}: Multus stays as it is; {error.hint}")


def install(cluster: Cluster, requested: Install, options: DeployOptions) -> MultusResult:
    """Install or update Multus and whereabouts, and prove that each machine attaches pods.

    Nothing is written if all is up to date and every machine has proved it before.

    Raises:
        ClusterError: a machine cannot attach pods; the causes are in the details.
        RolloutFailed, ConflictError, Refused: as in deploy.
        Forbidden: we have no right to do it.
        Interrupted: `options.cancel` was set.
    """
    try:
        return _install(cluster, requested, options)
    except Forbidden as error:
        if error.ground == "right":
            error.hint = "let an administrator run `rigel network install` once"
        raise


def _install(cluster: Cluster, requested: Install, options: DeployOptions) -> MultusResult:
    report = options.report
    complete = complete_options(cluster, requested)
    found = find(cluster, complete)
    installation = installation_of(found, complete)
    _report_others(found, report)
    for name in found.away:
        report.warn(f"machine {name} is not ready: the installation does not wait for it")
    if installation.multus or installation.whereabouts:
        Rollout(cluster, installation, found, options).run()
    return _prove_nodes(cluster, complete, report, options.cancel)


def installation_of(found: Found, options: Install, *, retired: bool = False) -> Installation:
    """Return what is to be installed; parts that others have installed are left to them."""
    return Installation(
        found.groups,
        options,
        multus=found.multus is None or found.multus.ours,
        whereabouts=found.whereabouts is None or found.whereabouts.ours,
        there=found.definitions,
        retired=retired,
    )


def _report_others(found: Found, report: Reporter) -> None:
    for name, part in (("Multus", found.multus), ("whereabouts", found.whereabouts)):
        if part and not part.ours:
            report.line(f"{name} is already installed ({part.where}, {part.image}), unchanged")


def _prove_nodes(
    cluster: Cluster, options: Install, report: Reporter, cancel: threading.Event
) -> MultusResult:
    """Let each machine attach a pod that has not proved it before."""
    found = find(cluster, options)
    if found.multus is None:
        raise ClusterError("Multus was removed while it was being installed")
    marks = marks_of(found)
    new = sorted(marks.keys() - find_proven(cluster, marks))
    failed = prove(cluster, new, found.multus.image, report, cancel) if new else {}
    if new:
        remember(cluster, {node: mark for node, mark in marks.items() if node not in failed})
    _report_failures(failed, found.multus, report)
    good = tuple(node for node in marks if node not in failed)
    return MultusResult(good, found.away, found.multus.where, found.multus.ours)


def marks_of(found: Found) -> dict[str, str]:
    """Return the current fingerprint of each machine that is up."""
    parts = [part for part in (found.multus, found.whereabouts) if part]
    sets = [one for part in parts for one in part.sets]
    up = set(found.up)
    nodes = [node for node in found.nodes if node["metadata"]["name"] in up]
    return {node["metadata"]["name"]: fingerprint(node, sets) for node in nodes}


def describe(done: MultusResult) -> str:
    """Return the result in one line."""
    names = ", ".join(done.nodes) or "no machine"
    away = f"; not tried, since unreachable: {', '.join(done.away)}" if done.away else ""
    return f"Multus ({done.multus}) attaches pods on {names}{away}"


def _report_failures(failed: Mapping[str, str], multus: MultusPart, report: Reporter) -> None:
    """Raise an error if our own Multus cannot attach; only warn if it is another one."""
    lines = [f"{node}: {cause}" for node, cause in sorted(failed.items())]
    if not lines:
        return
    if not multus.ours:
        for line in lines:
            report.warn(f"Multus ({multus.where}) attaches no pod on {line}")
        return
    raise ClusterError(
        f"{len(lines)} machine(s) cannot attach pods to a second network",
        hint=f"kubectl -n {RELEASE.namespace} logs daemonset/rigel-multus -c multus",
        details=lines,
    )

"""Multus and whereabouts as a part of a job: installed, and proved on every machine.

An installation by others is used unchanged. An unreachable machine is not waited for: it gets its
pods when it is back.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from rigel_k8s.deploy import deploy
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Install, Network
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.pinning import pin
from rigel_k8s.release.part import Hooks, Look, Part, Run, if_allowed
from rigel_k8s.release.revisions import find_last_good
from rigel_k8s.release.survey import belongs
from rigel_k8s.release.types import DeployOptions, Desired, Revision
from rigel_k8s.report import Reporter
from rigel_multus.installation import RELEASE, Installation, Presence, find_parts
from rigel_multus.manifests import (
    DEFINITIONS,
    machine_script,
    network_release,
    read_definitions,
)
from rigel_multus.platform import Group, group_by_platform, platform
from rigel_multus.proving import find_proven, list_marks, prove, remember

HINT = "let an administrator run `rigel network install` once"


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


@attrs.define(kw_only=True)
class MultusHooks(Hooks):
    """Around the installation: report what others have installed, and let all machines prove it.

    Attributes:
        installation: as the cluster has it now, and what is to be installed.
        result: set when it is installed.
    """

    installation: Installation
    result: MultusResult | None = None

    def before_write(self, run: Run, seen: Look) -> None:
        """Report what is not ours; let the roll-out go on without machines that are away."""
        for part, presence in self.installation.parts.items():
            if not presence.ours:
                name = part.replace("multus", "Multus")
                source = f"{presence.where}, {presence.image}"
                run.report.line(f"{name} is already installed ({source}), unchanged")
        if self.installation.installs and seen.settled is None:
            let_be_away(run.cluster, self.installation)

    def after_write(self, run: Run, revision: Revision | None, seen: Look) -> None:
        """Prove that each machine attaches pods.

        Raises:
            ClusterError: a machine cannot; the causes are in the details.
        """
        self.result = prove_nodes(run.cluster, self.installation.options, run.options)


def multus_part(
    given: Install, cluster: Cluster | None, *, own: bool = True, adopt: bool = True
) -> Part:
    """Return Multus and whereabouts as a job requests them; its hooks have the result.

    Args:
        cluster: None: as they are on a plain cluster.
        own: the job is about nothing else.

    Raises:
        Forbidden: we may not look at the cluster.
    """
    installation, unproven = Installation([Group(platform("plain"))], given), frozenset[str]()
    if cluster is not None:
        try:
            installation = find(cluster, given)
            proven = find_proven(cluster, installation)
            unproven = frozenset(list_marks(installation).keys() - proven)
        except Forbidden as error:
            if error.ground == "right":
                error.hint = HINT
            raise
    installs = installation.installs
    return Part(
        desired=find_release(cluster, installation) if installs else Desired(RELEASE, ()),
        rank="network",
        own=own,
        shared=True,
        foreign=not installs,
        unfinished=bool(unproven),
        adopt=adopt,
        hint=HINT,
        away=installation.away,
        hooks=MultusHooks(installation=installation),
    )


def find(cluster: Cluster, given: Install) -> Installation:
    """Look at a cluster.

    Raises:
        ClusterError: we may not read it, or it has no Linux machine.
    """
    options = complete_options(cluster, given)
    nodes = cluster.nodes()
    groups = group_by_platform(nodes, options)
    if not groups:
        raise ClusterError("cannot install Multus: the cluster has no Linux machine")
    parts = find_parts(cluster.list("apps/v1", "DaemonSet"))
    refs = [ref_of(definition) for definition in read_definitions(DEFINITIONS)]
    live = zip(refs, cluster.parallel(cluster.get, refs), strict=True)
    foreign = frozenset(ref.name for ref, one in live if one and not belongs(one, RELEASE))
    return Installation(groups, options, nodes, parts, foreign)


def complete_options(cluster: Cluster, given: Install) -> Install:
    """Return options in which those that are not set have the values of the last installation.

    Several Rigelfiles share a cluster's network: one with `install: true` must not revert the
    images and directories that another has set.
    """
    last = find_last_good(cluster, RELEASE)
    before = dict(last.options) if last else {}
    new = attrs.asdict(given, filter=lambda _, value: value is not None)
    return Install(**{**before, **new})


def find_release(cluster: Cluster | None, installation: Installation) -> Desired:
    """Return the desired state of the release, with images by digest."""
    desired = network_release(installation, machine_script())
    if cluster is None:
        return desired
    return pin(desired, find_last_good(cluster, RELEASE), lambda: installation.nodes)


def requested_multus(
    network: Network | None, cluster: Cluster | None, report: Reporter
) -> list[Part]:
    """Return the installation that an application's network requests; only modes with Multus can.

    With rights only for applications the cluster is used as it is, with a warning. `adopt` is meant
    for the application's objects, not for those in kube-system.
    """
    if network is None or network.install is None or not mode_of(network).attached:
        return []
    requested = network.install
    return if_allowed(
        lambda: multus_part(requested, cluster, own=False, adopt=False), "Multus", report
    )


def install(cluster: Cluster, requested: Install, options: DeployOptions) -> MultusResult:
    """Install or update both. Raises as rigel_k8s.deploy.deploy."""
    part = multus_part(requested, cluster)
    deploy([part], cluster, options)
    return result_of(part)


def result_of(part: Part) -> MultusResult:
    """Return what an installation has come to."""
    if not isinstance(part.hooks, MultusHooks) or part.hooks.result is None:
        raise AssertionError("only what is installed has a result")
    return part.hooks.result


def let_be_away(cluster: Cluster, installation: Installation) -> None:
    """Let roll-outs continue although machines are unreachable: Kubernetes would wait for them."""
    if not installation.away:
        return
    rolling = {"rollingUpdate": {"maxUnavailable": 1 + len(installation.away)}}
    for presence in installation.parts.values():
        for one in presence.sets if presence.ours else ():
            cluster.patch(ref_of(one), {"spec": {"updateStrategy": rolling}})


def prove_nodes(cluster: Cluster, options: Install, how: DeployOptions) -> MultusResult:
    """Let each machine attach a pod that has not proved it before."""
    installation = find(cluster, options)
    multus = installation.parts.get("multus")
    if multus is None:
        raise ClusterError("Multus was removed while it was being installed")
    marks = list_marks(installation)
    new = sorted(marks.keys() - find_proven(cluster, installation))
    failed = prove(cluster, new, multus.image, how.report, how.cancel) if new else {}
    if new:
        remember(cluster, {node: mark for node, mark in marks.items() if node not in failed})
    report_failures(failed, multus, how.report)
    good = tuple(sorted(marks.keys() - failed.keys()))
    return MultusResult(good, installation.away, multus.where, multus.ours)


def report_failures(failed: Mapping[str, str], multus: Presence, report: Reporter) -> None:
    """Raise an error if our own Multus cannot attach; only warn if it is another one."""
    lines = [f"{node}: {cause}" for node, cause in sorted(failed.items())]
    if lines and multus.ours:
        raise ClusterError(
            f"{len(lines)} machine(s) cannot attach pods to a second network",
            hint=f"kubectl -n {RELEASE.namespace} logs daemonset/rigel-multus -c multus",
            details=lines,
        )
    for line in lines:
        report.warn(f"Multus ({multus.where}) attaches no pod on {line}")


def describe(done: MultusResult) -> str:
    """Return the result in one line."""
    names = ", ".join(done.nodes) or "no machine"
    away = f"; not tried, since unreachable: {', '.join(done.away)}" if done.away else ""
    return f"Multus ({done.multus}) attaches pods on {names}{away}"

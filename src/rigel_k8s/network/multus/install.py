"""Multus and whereabouts as a part of a job: installed, and proved on every machine.

An installation by others is used unchanged. An unreachable machine is not waited for: it gets its
pods when it is back.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.desired import Installation, machine_script, network_release
from rigel_k8s.network.multus.installation import Found, MultusPresence, complete_options, find
from rigel_k8s.network.multus.platform import platform
from rigel_k8s.network.multus.proving import find_proven, fingerprint, prove, remember
from rigel_k8s.network.multus.recognition import Group
from rigel_k8s.network.multus.rollout import Rollout
from rigel_k8s.network.options import Install, Network
from rigel_k8s.pinning import pin
from rigel_k8s.release.deploy import Look, find_last_good
from rigel_k8s.release.refusals.foresight import Foreseen
from rigel_k8s.release.survey import Survey
from rigel_k8s.release.together import Part, SharedPart, deploy, if_allowed
from rigel_k8s.release.types import DeployOptions, Desired, Plan
from rigel_k8s.report import Reporter

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
class MultusPart(SharedPart):
    """Multus and whereabouts.

    Attributes:
        options: completed by those of earlier installations.
        found: the cluster before.
        unproven: machines that have not attached a pod with what is installed now.
        result: set when it is installed.
    """

    options: Install
    installation: Installation
    found: Found
    unproven: frozenset[str]
    result: MultusResult | None = None

    @property
    def installs(self) -> bool:
        """Whether any of it is ours."""
        return self.installation.multus or self.installation.whereabouts

    def look(self, cluster: Cluster, *, adopt: bool) -> Look:
        """Return what would be done: nothing where others have installed it."""
        if self.installs:
            return super().look(cluster, adopt=adopt)
        nothing = Survey(self.desired, (), {}, Foreseen(), None, (), None)
        return Look(nothing, Plan(RELEASE, ()))

    def changes(self, looked: Look) -> bool:
        """Whether something is to be installed, or proved."""
        return bool(self.unproven) or (self.installs and super().changes(looked))

    def write(self, cluster: Cluster, looked: Look, options: DeployOptions) -> None:
        """Install or update both, and prove that each machine attaches pods.

        Raises:
            ClusterError: a machine cannot attach pods; the causes are in the details.
        """
        report_others(self.found, options.report)
        self.warn_of_away(options.report)
        if self.installs:
            options = attrs.evolve(options, description="network")
            rollout = Rollout(cluster, self.installation, self.found, options)
            if super().changes(looked):
                rollout.let_be_away()
            self.install(cluster, looked, options)
            rollout.wait()
        self.result = prove_nodes(cluster, self.options, options)


def multus_part(
    given: Install, cluster: Cluster | None, *, own: bool = True, adopt: bool = True
) -> MultusPart:
    """Return Multus and whereabouts as a job requests them.

    Args:
        cluster: None: as they are on a plain cluster.
        own: the job is about nothing else.

    Raises:
        Forbidden: we may not look at the cluster.
    """
    if cluster is None:
        found = Found((), (Group(platform("plain"), ()),), None, None, frozenset())
        options, unproven = given, frozenset[str]()
    else:
        try:
            options = complete_options(cluster, given)
            found = find(cluster, options)
            marks = marks_of(found)
            unproven = frozenset(marks.keys() - find_proven(cluster, marks))
        except Forbidden as error:
            if error.ground == "right":
                error.hint = HINT
            raise
    installation = installation_of(found, options)
    desired = Desired(RELEASE, ())
    if installation.multus or installation.whereabouts:
        desired = find_release(cluster, installation, found)
    return MultusPart(
        desired=desired,
        rank="network",
        own=own,
        adopt=adopt,
        hint=HINT,
        away=found.away,
        options=options,
        installation=installation,
        found=found,
        unproven=unproven,
    )


def find_release(cluster: Cluster | None, installation: Installation, found: Found) -> Desired:
    """Return the desired state of the release, with images by digest."""
    desired = network_release(installation, machine_script())
    if cluster is None:
        return desired
    return pin(desired, find_last_good(cluster, RELEASE), lambda: found.nodes)


def requested_multus(
    network: Network | None, cluster: Cluster | None, report: Reporter
) -> list[Part]:
    """Return the installation that an application's network requests.

    With rights only for applications the cluster is used as it is, with a warning. `adopt` is meant
    for the application's objects, not for those in kube-system.
    """
    requested = install_requested_by(network)
    if requested is None:
        return []
    return if_allowed(
        lambda: multus_part(requested, cluster, own=False, adopt=False), "Multus", report
    )


def install(cluster: Cluster, requested: Install, options: DeployOptions) -> MultusResult:
    """Install or update both. Raises as release.together.deploy."""
    part = multus_part(requested, cluster)
    deploy([part], cluster, options)
    assert part.result is not None
    return part.result


def install_requested_by(network: Network | None) -> Install | None:
    """Return the installation that a network requests; only modes with Multus can."""
    if network is None or network.install is None or not mode_of(network).attached:
        return None
    return network.install


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


def report_others(found: Found, report: Reporter) -> None:
    """Report what others have installed."""
    for name, part in (("Multus", found.multus), ("whereabouts", found.whereabouts)):
        if part and not part.ours:
            report.line(f"{name} is already installed ({part.where}, {part.image}), unchanged")


def prove_nodes(cluster: Cluster, options: Install, how: DeployOptions) -> MultusResult:
    """Let each machine attach a pod that has not proved it before."""
    found = find(cluster, options)
    if found.multus is None:
        raise ClusterError("Multus was removed while it was being installed")
    marks = marks_of(found)
    new = sorted(marks.keys() - find_proven(cluster, marks))
    failed = prove(cluster, new, found.multus.image, how.report, how.cancel) if new else {}
    if new:
        remember(cluster, {node: mark for node, mark in marks.items() if node not in failed})
    report_failures(failed, found.multus, how.report)
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


def report_failures(failed: Mapping[str, str], multus: MultusPresence, report: Reporter) -> None:
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

"""status and list: what runs where, for one release or all of them.

Scripts call it often, so it imports nothing that only a deploy needs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s.commands import clocks
from rigel_k8s.commands.targets import list_namespaces, release
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube import connect
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.problems import Problem
from rigel_k8s.release.listing import ReleaseSummary, list_releases
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.status import ReleaseStatus
from rigel_k8s.release.status import status as read_status
from rigel_k8s.rosgraph.discovery.check import survey
from rigel_k8s.rosgraph.discovery.findings import DiscoveryGraph
from rigel_k8s.rosgraph.discovery.looks import SPAN
from rigel_k8s.rosgraph.ros1 import read_gate
from rigel_k8s.rosgraph.types import GateStatus
from rigel_k8s.settings import Settings

if TYPE_CHECKING:
    from rigel_k8s.rosgraph.expectations import Verdict


@attrs.frozen
class Status:
    """What runs where, for one release.

    Attributes:
        graph: which nodes discover each other; None without DDS, or if not requested.
        gate: the state of roscore's gate; None without one, or if not requested.
        clocks: machines whose clocks differ; None if not requested.
        expect: how topics are, as far as seconds show; None without `expect`, or if not requested.
    """

    release: ReleaseStatus
    graph: DiscoveryGraph | None = None
    gate: GateStatus | None = None
    clocks: Sequence[Problem] | None = None
    expect: Sequence[Verdict] | None = None

    @property
    def ok(self) -> bool:
        """Whether everything required is ready, and all nodes reach the others."""
        return self.release.ok and not (self.graph and self.graph.errors)


def status(settings: Settings, job: str | None, *, graph: bool = True) -> Status:
    """Return what runs where, for one release.

    Args:
        graph: check from inside its pods whether DDS nodes discover each other, and read the state
            of roscore's gate, the machines' clocks and topics of which something is expected;
            takes seconds.

    Raises:
        UserError: the cluster has nothing of it.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        state = read_status(cluster, found.id)
        if not graph:
            return Status(state)
        pods = list_pods(cluster, found.id)
        reading = clocks.begin(cluster, pods)
        seen, gate = survey(cluster, found.id), read_gate(cluster, found.id)
        verdicts = judge_topics(cluster, state, pods, seen)
        return Status(state, seen, gate, clocks.judge(clocks.finish(reading)), verdicts)


def judge_topics(
    cluster: Cluster,
    state: ReleaseStatus,
    pods: Sequence[Mapping[str, Any]],
    seen: DiscoveryGraph | None,
) -> Sequence[Verdict] | None:
    """Return how topics are beside what is expected of them; None if nothing is, or was measured.

    What nodes have noted for `seen` is enough; without it, in ROS 1, they are asked for a second.
    """
    try:
        options = state.last_good.revision().options if state.last_good else {}
        if not options.get("expect") or (seen and not seen.notes):
            return None
        from rigel_k8s.commands.expect import parse_expected
        from rigel_k8s.rosgraph import expectations, reading, ros2
        from rigel_k8s.rosgraph import pods as graph_pods

        expected = parse_expected(options)
        if seen is None:
            graph = reading.read_graph(cluster, state.release, span=SPAN)
            return expectations.compare_with(expected, graph)
        known = {pod.key: pod for pod in graph_pods.read_pods(pods)}
        notes = {key: answer for key, answer in seen.notes.items() if key in known}
        graph = attrs.evolve(ros2.parse(notes, known), span=SPAN)
        return expectations.compare_own(expected, graph)
    except RigelK8sError:  # `rigel expect` reports why
        return None


def releases(settings: Settings, *, everywhere: bool) -> tuple[list[str], list[ReleaseSummary]]:
    """Return the listed namespaces, none for all, and their releases.

    They are those of the Rigelfile, if there is one, or the context's.

    Raises:
        Forbidden: the right to list Secrets or workloads is missing.
    """
    with connect(settings) as cluster:
        namespaces = [] if everywhere else list_namespaces(settings, cluster)
        asked: Sequence[str | None] = namespaces or (None,)
        try:
            found = [list_releases(cluster, name) for name in asked]
        except Forbidden as error:
            if everywhere:
                error.hint = "list one namespace only with `rigel list -n NAMESPACE`, without -A"
            raise
    return namespaces, [one for part in found for one in part]

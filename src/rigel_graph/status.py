"""What is seen from inside a release's pods, and what `rigel status` shows of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import zip_longest
from typing import Any
from urllib.parse import urlsplit

import attrs

from rigel_graph.discovery.check import survey
from rigel_graph.discovery.findings import DiscoveryGraph, PodGraph
from rigel_graph.discovery.looks import SPAN
from rigel_graph.expectations import Verdict, compare_own, compare_with
from rigel_graph.pods import read_pods
from rigel_graph.ros1 import read_gate
from rigel_graph.types import GateStatus
from rigel_k8s.app.deploying.guests import StatusAddition
from rigel_k8s.commands.clocks import begin, finish, judge
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.problems import Problem
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.status import ReleaseStatus

#: The columns of a DDS graph.
HEADS = ("INTERFACE", "ADDRESS", "DISCOVERED")


def look(cluster: Cluster, state: ReleaseStatus) -> StatusAddition:
    """Return what is seen; takes seconds."""
    pods = list_pods(cluster, state.release)
    reading = begin(cluster, pods)
    seen, gate = survey(cluster, state.release), read_gate(cluster, state.release)
    verdicts = judge_topics(cluster, state, pods, seen)
    return describe(state, seen, gate, judge(finish(reading)), verdicts)


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
        from rigel_graph import reading, ros2
        from rigel_graph.commands.expect import parse_expected

        expected = parse_expected(options)
        if seen is None:
            graph = reading.read_graph(cluster, state.release, span=SPAN)
            return compare_with(expected, graph)
        known = {pod.key: pod for pod in read_pods(pods)}
        notes = {key: answer for key, answer in seen.notes.items() if key in known}
        graph = attrs.evolve(ros2.parse(notes, known), span=SPAN)
        return compare_own(expected, graph)
    except RigelK8sError:  # `rigel expect` reports why
        return None


def describe(
    state: ReleaseStatus,
    graph: DiscoveryGraph | None = None,
    gate: GateStatus | None = None,
    clocks: Sequence[Problem] = (),
    expect: Sequence[Verdict] | None = None,
) -> StatusAddition:
    """Return what `rigel status` shows: of clocks, those that differ."""
    return StatusAddition(
        heads=() if graph is None else HEADS,
        cells={} if graph is None else {pod.pod: list_cells(pod) for pod in graph.pods},
        lines=(
            *problem_lines(graph.problems if graph is not None else ()),
            *(gate_lines(gate, state) if gate is not None else ()),
            *problem_lines(clocks),
            *dict.fromkeys(one.line for one in expect or () if one.broken),
        ),
        notes=() if graph is None else tuple(memory_lines(graph)),
        json={
            "graph": None if graph is None else graph_json(graph),
            "gate": None if gate is None else attrs.asdict(gate),
            "clocks": [problem.to_json() for problem in clocks],
            "expect": None if expect is None else [verdict.to_json() for verdict in expect],
        },
        ok=not (graph and graph.errors),
    )


def list_cells(pod: PodGraph) -> Sequence[str]:
    """Return a pod's cells: its interface, its address, discovered in how many other pods."""
    unknown = pod.discovered_by is None or not pod.out_of
    discovered = "-" if unknown else f"{len(pod.discovered_by or ())}/{pod.out_of}"
    return pod.interface or "all", pod.address or "-", discovered


def problem_lines(problems: Sequence[Problem]) -> Iterator[str]:
    """Yield what is wrong, and what to do: once if it is the same for several."""
    for problem, following in zip_longest(problems, problems[1:]):
        same = following is not None and following.remedy == problem.remedy
        yield f"{problem.message} [{problem.kind}]" if same else problem.text


def memory_lines(graph: DiscoveryGraph) -> Iterator[str]:
    """Yield which nodes exchange their messages by shared memory."""
    groups: dict[str, list[str]] = {}
    for pod in graph.pods:
        if pod.memory:
            groups.setdefault(pod.memory, []).append(pod.pod.rpartition("/")[2])
    for memory, names in groups.items():
        if len(names) > 1:
            yield f"by shared memory of the {memory}: {', '.join(names)}"


def gate_lines(gate: GateStatus, found: ReleaseStatus) -> Iterator[str]:
    """Yield lines for users: calls that wait, what was lost, nodes that wait or are silent."""
    pods = {pod.ip: pod.name for workload in found.workloads for pod in workload.pods if pod.ip}

    def place(api: str) -> str:
        host = urlsplit(api).hostname or api
        return f"pod {pods[host]}" if host in pods else f"{host} (no pod of this release)"

    if gate.problem:
        yield f"cannot reach the gate in front of roscore: {gate.problem}"
        return
    if gate.blocked:
        yield f"{gate.blocked}; calls to the master wait until it succeeds"
    elif not gate.has_master:
        yield "roscore does not answer its gate; calls to the master wait until it does"
    for refusal in gate.refused:
        yield f"roscore did not accept again the {refusal}; restart the pod of its node"
    for why in gate.unkept:
        yield f"{why}; a new ros-master pod would not have the latest registrations and parameters"
    yield from gate.notes
    for node in gate.waiting:
        behind = f"take over from {place(node.owner)}" if node.owner else "have its name"
        yield f"{node.node}: {place(node.api)} waits to {behind}"
    for one in gate.conflicts:
        when = (
            f"{one.seconds:.0f} s ago" if one.seconds < 120 else f"{one.seconds / 60:.0f} min ago"
        )
        yield (
            f"{one.node}: {place(one.old)} lost its name to {place(one.new)} {when}; ROS 1 allows"
            " one node of a name: stop one of the two, or rename it"
        )
    for name in gate.silent:
        yield f"{name} has not answered since roscore restarted; it is registered once it does"


def graph_json(graph: DiscoveryGraph) -> dict[str, Any]:
    """Return a graph for scripts (docs/discovery.md)."""
    return {
        "ok": not graph.problems,
        "deaf": [{"from": one, "to": other} for one, other in graph.deaf],
        "problems": [problem.to_json() for problem in graph.problems],
        "pods": [attrs.asdict(pod) for pod in graph.pods],
    }

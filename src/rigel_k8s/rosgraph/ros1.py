"""The graph of a ROS 1 master, read from inside a pod of the release.

Why a program in a pod: nodes register addresses that only pods reach, and their own API has what no
master has: whether a node answers, the types it uses, how many messages it has sent. It runs where
the master runs, whose container always has a Python. scripts/ros1_graph.py makes the requests; this
module decides what its answers mean.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rigel_exporter.ros1_traffic import Ledger
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.rosgraph.inside import read_module, run_inside
from rigel_k8s.rosgraph.pods import GraphPod
from rigel_k8s.rosgraph.types import GraphNode, GraphService, GraphTopic, Mismatch, RosGraph

#: Every exporter's name begins with it. Exporters read the graph and are left out of it.
EXPORTER_NAME = "/ros_exporter"
#: What the master and nodes report instead of an unknown type.
NO_TYPE = ("", "*")
PYTHONS = ("python3", "python", "python2")


def read(cluster: Cluster, pods: Sequence[GraphPod]) -> RosGraph:
    """Return the graph as the master and its nodes report it, without machines and pods.

    Raises:
        ClusterError: no pod runs in which to run the request, or the master does not answer.
    """
    modules = [
        ("rosrpc", read_module("rigel_inpod.rosrpc")),
        ("ros1_graph", read_module("rigel_inpod.sent.ros1_graph")),
    ]
    return parse(run_inside(cluster, choose_pod(pods), modules, pythons=PYTHONS))


def choose_pod(pods: Sequence[GraphPod]) -> GraphPod:
    """Return the pod in which to run the request: the master's, else a node's that is ready.

    Raises:
        ClusterError: none runs.
    """
    masters = [pod for pod in pods if pod.is_master]
    running = [pod for pod in masters or pods if pod.running and not pod.is_exporter]
    if not running:
        what = "roscore" if masters else "no pod of the release"
        verb = "does not run" if masters else "runs"
        raise ClusterError(
            f"cannot read the ROS graph: {what} {verb}", hint="`rigel status` shows the cause"
        )
    return max(running, key=lambda pod: (pod.ready, pod.name))


def parse(answer: Mapping[str, Any]) -> RosGraph:
    """Return the graph that scripts/ros1_graph.py has printed."""
    said = {one["name"]: one for one in answer["nodes"] if not is_exporter(one["name"])}
    rates = measure_rates(said.values())
    topics = sorted({*answer["publishers"], *answer["subscribers"]})
    made = [parse_topic(name, answer, said, rates.get(name)) for name in topics]
    services = [
        GraphService(name, providers=tuple(sorted(set(owners))))
        for name, owners in sorted(answer["services"].items())
        if not all(is_exporter(owner) for owner in owners)
    ]
    return RosGraph(
        nodes=tuple(
            GraphNode(name, address=one.get("address", ""), up="pid" in one)
            for name, one in sorted(said.items())
        ),
        topics=tuple(topic for topic in made if topic.publishers or topic.subscribers),
        services=tuple(services),
    )


def parse_topic(
    name: str, answer: Mapping[str, Any], said: Mapping[str, Mapping[str, Any]], rate: float | None
) -> GraphTopic:
    """Return one topic; its type is the one that most of its nodes use."""
    publishers = list_others(answer["publishers"].get(name, ()))
    subscribers = list_others(answer["subscribers"].get(name, ()))
    used = [
        (node, kind)
        for part, nodes in (("publications", publishers), ("subscriptions", subscribers))
        for node in nodes
        for topic, kind in said.get(node, {}).get(part, ())
        if topic == name and kind not in NO_TYPE
    ]
    kind, mismatches = compare_types(used)
    if not kind and answer["types"].get(name) not in NO_TYPE:
        kind = answer["types"].get(name, "")
    return GraphTopic(name, kind, publishers, subscribers, mismatches, rate)


def compare_types(used: Sequence[tuple[str, str]]) -> tuple[str, tuple[Mismatch, ...]]:
    """Return the type that most nodes use (of equals the first), and the nodes with another one.

    Args:
        used: (node, type) of each endpoint, publishers first.
    """
    counts = Counter(kind for _, kind in used)
    kind = counts.most_common(1)[0][0] if counts else ""
    others = sorted({(node, other) for node, other in used if other != kind})
    return kind, tuple(Mismatch(node, other) for node, other in others)


def list_others(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of nodes, sorted, without exporters'."""
    return tuple(sorted({name for name in names if not is_exporter(name)}))


def is_exporter(name: str) -> bool:
    """Whether a node is a ROS exporter."""
    return name == EXPORTER_NAME or name.startswith(f"{EXPORTER_NAME}_")


def measure_rates(counted: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Return messages per second by topic, from publishers' counters; only topics with messages.

    A publisher counts by connection: a topic without subscribers counts nothing.
    """
    rates: dict[str, float] = {}
    for node in counted:
        if "stats" not in node or not node["seconds"] > 0:
            continue
        ledger, before = Ledger(), {}
        for stats in node["stats"]:
            before = {part.topic: part.messages for part in ledger.totals() if is_sent(part)}
            ledger.add(node["name"], node["uri"], stats)
        for part in ledger.totals():
            if is_sent(part) and part.messages:
                grown = (part.messages - before.get(part.topic, 0)) / node["seconds"]
                rates[part.topic] = rates.get(part.topic, 0.0) + grown
    return rates


def is_sent(part: Any) -> bool:
    """Whether a count is of messages that a node published."""
    return bool(part.direction == "published")

"""The graph of ROS 2, from what the processes of a release's pods have noted.

Why: the layer in each process has its exact entities, types and counts, for every middleware, and
the names of the nodes that it has discovered; nothing has to be heard. Nodes that are only
discovered have no layer, or are outside of the release: their endpoints are read from DDS.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import attrs

from rigel_exporter.notes import Part, list_discovered, list_nodes, list_parts
from rigel_graph import dds
from rigel_graph.discovery.inside import Unread, read_notes
from rigel_graph.discovery.losses import SETTLED, find_losses, measure_flows
from rigel_graph.discovery.members import Member
from rigel_graph.pods import GraphPod
from rigel_graph.types import SPAN, GraphNode, GraphService, GraphTopic, RosGraph, compare_types
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.problems import Problem

#: What a pod has printed: `first` and `second`.
Answer = Mapping[str, Mapping[str, Any]]


def read(
    cluster: Cluster, pods: Sequence[GraphPod], members: Sequence[Member], span: float = SPAN
) -> RosGraph:
    """Return the graph, with the pods of those nodes that have the layer.

    Args:
        span: seconds between two readings.

    Raises:
        ClusterError: no pod with the layer could be read, nor DDS in its place.
    """
    answers, failures = ask_all(cluster, pods, span)
    if not answers:
        if failures:
            raise failures[0]
        return dds.read(cluster, pods, members)
    graph = attrs.evolve(parse(answers, {pod.key: pod for pod in pods}), notes=answers)
    strangers = [node for node in graph.nodes if not node.pod]
    if not strangers or any(member.middleware == "zenoh" for member in members):
        return graph
    try:
        return add(graph, dds.read(cluster, pods, members))
    except ClusterError:
        return graph  # their names are known


def ask_all(
    cluster: Cluster, pods: Iterable[GraphPod], span: float
) -> tuple[dict[str, Answer], list[Unread]]:
    """Return what the running pods with the layer have noted, by their keys, and what failed.

    Args:
        span: seconds between two readings; 0 for one.
    """
    layered = [pod for pod in pods if pod.has_layer and pod.running]
    found = cluster.parallel(partial(ask, cluster, span=span), layered)
    answers: dict[str, Answer] = {}
    failures: list[Unread] = []
    for pod, answer in zip(layered, found, strict=True):
        if isinstance(answer, Unread):
            failures.append(answer)
        else:
            answers[pod.key] = answer
    return answers, failures


def ask(cluster: Cluster, pod: GraphPod, span: float = SPAN) -> Answer | Unread:
    """Return what the processes of a pod have noted, or why that cannot be read."""
    try:
        return read_notes(cluster, pod, span)
    except Unread as error:
        return error


def parse(answers: Mapping[str, Answer], pods: Mapping[str, GraphPod]) -> RosGraph:
    """Return the graph that pods have noted, by their keys; one that waits is not in it."""
    seconds = {pod: answer["second"] for pod, answer in answers.items()}
    nodes: dict[str, GraphNode] = {name: GraphNode(name) for name in list_discovered(seconds)}
    for name, second in seconds.items():
        pod = pods[name]
        for node, stands in list_nodes({name: second}).items():
            nodes[node] = GraphNode(
                node,
                machine=pod.machine,
                pod=pod.name,
                workload=pod.workload,
                address=min(pod.addresses, default=""),
                ready=pod.ready,
                stands=stands,
            )
    parts: dict[tuple[str, str], list[Part]] = defaultdict(list)
    for part in list_parts(seconds):
        parts[part.kind, part.name].append(part)
    rates = measure_rates(answers)
    losses: dict[str, list[Problem]] = defaultdict(list)
    pairs = (measure_flows(one["first"], one["second"]) for one in answers.values())
    for loss in find_losses(flow for flows in pairs for flow in flows):
        losses[loss.topic].append(loss.problem)
    topics = {name for kind, name in parts if kind in ("publisher", "subscription")}
    return RosGraph(
        nodes=tuple(sorted(nodes.values(), key=lambda node: node.name)),
        topics=tuple(
            attrs.evolve(
                make_topic(
                    name, parts["publisher", name], parts["subscription", name], rates[name]
                ),
                losses=tuple(losses[name]),
            )
            for name in sorted(topics)
        ),
        services=tuple(
            GraphService(name, found[0].type, name_nodes(found))
            for (kind, name), found in sorted(parts.items())
            if kind == "service"
        ),
    )


def make_topic(
    name: str, publishers: Sequence[Part], subscribers: Sequence[Part], rate: float
) -> GraphTopic:
    kind, mismatches = compare_types(
        [(part.node, part.type) for part in (*publishers, *subscribers) if part.type]
    )
    alone = [part for part in subscribers if publishers and is_alone(part, publishers)]
    alone += [part for part in publishers if subscribers and is_alone(part, subscribers)]
    senders, hearers = name_nodes(publishers), name_nodes(subscribers)
    return GraphTopic(
        name,
        kind,
        senders,
        hearers,
        mismatches,
        rate,
        gap=max((part.gap for part in publishers if part.messages), default=None),
        age=max((part.age for part in subscribers if part.messages), default=None),
        exists=min((part.exists for part in publishers), default=None),
        alone=name_nodes(alone),
    )


def is_alone(part: Part, others: Iterable[Part]) -> bool:
    """Whether a part has no partner, although it has had time to find one of its type."""
    possible = [one for one in others if one.type == part.type and one.exists > SETTLED]
    return bool(possible) and part.exists > SETTLED and not part.matched


def name_nodes(parts: Iterable[Part]) -> tuple[str, ...]:
    """Return the names of the nodes, sorted, each once."""
    return tuple(sorted({part.node for part in parts}))


def measure_rates(answers: Mapping[str, Answer]) -> Mapping[str, float]:
    """Return messages per second by topic: of its publishers, else of one that hears most."""
    sent: dict[str, float] = defaultdict(float)
    heard: dict[str, float] = defaultdict(float)
    for pod, answer in answers.items():
        first, second = answer["first"], answer["second"]
        seconds = (second["now"] - first["now"]) / 1e9
        before = {(p.process, p.kind, p.name): p.messages for p in list_parts({pod: first})}
        for part in list_parts({pod: second}):
            grown = part.messages - before.get((part.process, part.kind, part.name), 0)
            if part.kind == "publisher":
                sent[part.name] += grown / seconds
            elif part.kind == "subscription":
                heard[part.name] = max(heard[part.name], grown / seconds)
    return defaultdict(float, {**heard, **sent})


def add(graph: RosGraph, heard: RosGraph) -> RosGraph:
    """Return a graph with the nodes of another one that it has no notes of, and their topics."""
    own = {node.name for node in graph.nodes if node.pod}
    nodes = {node.name: node for node in (*graph.nodes, *heard.nodes)}
    nodes |= {node.name: node for node in graph.nodes if node.pod}
    topics = {topic.name: topic for topic in graph.topics}
    for other in heard.topics:
        senders = tuple(name for name in other.publishers if name not in own)
        hearers = tuple(name for name in other.subscribers if name not in own)
        if senders or hearers:
            topic = topics.get(other.name) or attrs.evolve(other, publishers=(), subscribers=())
            topics[other.name] = attrs.evolve(
                topic,
                publishers=tuple(sorted({*topic.publishers, *senders})),
                subscribers=tuple(sorted({*topic.subscribers, *hearers})),
                mismatches=tuple({*topic.mismatches, *other.mismatches}),
            )
    services = {service.name: service for service in (*heard.services, *graph.services)}
    return attrs.evolve(
        graph,
        nodes=tuple(nodes[name] for name in sorted(nodes)),
        topics=tuple(topics[name] for name in sorted(topics)),
        services=tuple(services[name] for name in sorted(services)),
    )

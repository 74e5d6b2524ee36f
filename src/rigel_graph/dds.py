"""The graph of a DDS domain, ROS 2's or another, heard from inside a pod of the release.

Why a program in a pod: discovery is received in the pods' network only. Why not the exporter's
metrics: they count endpoints by topic, and a picture needs to show which node has which; that is in
discovery and in ros_discovery_info, which the exporter's modules read already. So these modules are
sent into a pod, join discovery for a few seconds, and leave. That needs no exporter and no ROS, but
Python 3.9. The participant joins as `ros2 node list` would, without being a node: its one reader is
for ros_discovery_info. rigel_exporter/dds_graph.py runs there; this module reads its output.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rigel_exporter import dds_names as names
from rigel_graph.discovery.inside import choose_domain, configure, listen
from rigel_graph.discovery.members import Member
from rigel_graph.pods import GraphPod
from rigel_graph.types import GraphNode, GraphService, GraphTopic, RosGraph, compare_types
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster

#: Requests to a service: its providers read them, its clients write them.
REQUEST, REQUESTS = "rq/", "Request"


def read(cluster: Cluster, pods: Sequence[GraphPod], members: Sequence[Member]) -> RosGraph:
    """Return the graph from discovery, without machines and pods.

    Raises:
        ClusterError: no pod runs to listen in, its Python is too old, or the nodes speak zenoh,
            whose discovery this does not read; or none takes part.
    """
    if not members:
        raise ClusterError("the release has no ROS graph: none of its nodes uses ROS or DDS")
    if all(member.middleware == "zenoh" for member in members):
        raise ClusterError(
            "cannot read the ROS graph: the nodes use zenoh, and only DDS discovery can be read",
            hint="`rigel exec NODE -- ros2 node list` lists them from one of the nodes",
        )
    domain = choose_domain(members)
    config = configure(members, domain)
    failures = []
    for pod in choose_pods(pods, members, domain):
        try:
            return parse(listen(cluster, pod, config))
        except ClusterError as error:
            failures.append(error)
    if not failures:
        raise ClusterError(
            "cannot read the ROS graph: no pod of the release runs",
            hint="`rigel status` shows the cause",
        )
    raise ClusterError(
        "cannot listen to DDS discovery in a pod of the release",
        details=[error.message for error in failures],
        hint="it needs Python 3.9 in a node's image; `observability: {enabled: true}` deploys the"
        " ROS exporter, whose image has it",
    )


def choose_pods(
    pods: Sequence[GraphPod], members: Sequence[Member], domain: int, most: int = 3
) -> list[GraphPod]:
    """Return pods to try: the exporter's, whose image has the Python, then nodes of the domain."""
    inside = {member.pod for member in members if (member.domain or 0) == domain}
    running = [pod for pod in pods if pod.running and (pod.is_exporter or pod.name in inside)]
    return sorted(running, key=lambda pod: (not pod.is_exporter, not pod.ready, pod.name))[:most]


def parse(answer: Mapping[str, Any]) -> RosGraph:
    """Return the graph that rigel_exporter/dds_graph.py has printed."""
    publishers, subscribers = group(answer["writers"]), group(answer["readers"])
    return RosGraph(
        nodes=tuple(
            GraphNode(one["name"], address=one["address"], up=one["up"]) for one in answer["nodes"]
        ),
        topics=tuple(
            parse_topic(names.topic_name(name), publishers[name], subscribers[name])
            for name in sorted({*publishers, *subscribers}, key=names.topic_name)
            if not names.is_service(name)
        ),
        services=tuple(
            parse_service(name, subscribers[name])
            for name in sorted(subscribers)
            if name.startswith(REQUEST)
        ),
    )


def group(endpoints: Iterable[Sequence[str]]) -> defaultdict[str, list[tuple[str, str]]]:
    """Return (node, ROS type) of endpoints by the DDS name of their topic."""
    found: defaultdict[str, list[tuple[str, str]]] = defaultdict(list)
    for node, topic, kind in endpoints:
        found[topic].append((node, names.type_name(kind)))
    return found


def parse_topic(
    name: str, publishers: Sequence[tuple[str, str]], subscribers: Sequence[tuple[str, str]]
) -> GraphTopic:
    kind, mismatches = compare_types([*publishers, *subscribers])
    return GraphTopic(name, kind, name_nodes(publishers), name_nodes(subscribers), mismatches)


def parse_service(topic: str, providers: Sequence[tuple[str, str]]) -> GraphService:
    """Return the service whose requests a topic carries: rq/NAMERequest of TYPE_Request."""
    name = topic[len(REQUEST) - 1 :].removesuffix(REQUESTS)
    kind = min((kind for _, kind in providers), default="").removesuffix(f"_{REQUESTS}")
    return GraphService(name, kind, name_nodes(providers))


def name_nodes(endpoints: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return the names of nodes; an endpoint that belongs to no node has none."""
    return tuple(sorted({node for node, _ in endpoints if node}))

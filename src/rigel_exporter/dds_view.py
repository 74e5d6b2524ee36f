"""A participant's view of the domain, as a graph of ROS nodes and topics.

Why: DDS has participants and endpoints; a ROS node is a name that participants announce, a topic a
name that endpoints share. It must not depend on RTPS.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping

from rigel_exporter import dds_names as names
from rigel_exporter.dds_discovery import Endpoint
from rigel_exporter.dds_peer import Peer
from rigel_exporter.graph import Graph, Node, Topic

OURS = "rigel-k8s "  # the names of our own participants begin with it; they are not counted


def graph(
    peers: Iterable[Peer], writers: Mapping[bytes, Endpoint], readers: Mapping[bytes, Endpoint]
) -> Graph:
    """Return the graph of participants and their endpoints by GUID."""
    others, ours = [], set()
    for peer in peers:
        if peer.announced.name.startswith(OURS):
            ours.add(peer.announced.prefix)
        elif not peer.is_server:
            others.append(peer)
    published, subscribed = _count_endpoints(writers, ours), _count_endpoints(readers, ours)
    topics = [Topic(*key, published[key], subscribed[key]) for key in {**published, **subscribed}]
    return Graph(nodes=_nodes(others), topics=topics)


def _nodes(peers: Iterable[Peer]) -> list[Node]:
    """Return the nodes of all participants.

    If two participants have the same ROS name, it is one node, and one of them may have ended: the
    node is up if any answers. Programs without ROS names share a name: it is up if all answer.
    """
    found: dict[str, Node] = {}
    for peer in peers:
        address = min(peer.sources, default="")
        for name in list(peer.nodes) or ([] if peer.is_ros else [peer.name]):
            known = found.get(name)
            if known is None or (peer.answers if peer.nodes else not peer.answers):
                found[name] = Node(name, up=peer.answers, registered=True, address=address)
    return list(found.values())


def _count_endpoints(
    endpoints: Mapping[bytes, Endpoint], ours: set[bytes]
) -> Counter[tuple[str, str]]:
    """Return how many endpoints each topic has; services' and ROS' own topics are left out."""
    return Counter(
        (names.topic_name(endpoint.topic), names.type_name(endpoint.type))
        for guid, endpoint in endpoints.items()
        if guid[:12] not in ours
        and endpoint.topic != names.NODES
        and not names.is_service(endpoint.topic)
    )

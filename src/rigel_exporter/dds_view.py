"""A participant's view of the domain, as a graph of ROS nodes and topics.

Why: DDS has participants and endpoints; a ROS node is a name that participants announce, a topic a
name that endpoints share. It must not depend on RTPS.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping

from rigel_exporter import dds_names as names
from rigel_exporter.dds_discovery import Endpoint
from rigel_exporter.dds_peer import Peer
from rigel_exporter.graph import Graph, Node, Topic

OURS = "rigel-k8s "  # the names of our own participants begin with it; they are not counted


def find_others(peers: Iterable[Peer]) -> dict[bytes, Peer]:
    """Return the participants of applications by their prefixes: neither ours, nor servers."""
    return {
        peer.announced.prefix: peer
        for peer in peers
        if not peer.announced.name.startswith(OURS) and not peer.is_server
    }


def list_nodes(peers: Iterable[Peer]) -> list[Node]:
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


def list_endpoints(endpoints: Mapping[bytes, Endpoint], others: Container[bytes]) -> list[Endpoint]:
    """Return the endpoints of these participants, without those that only announce nodes."""
    return [
        endpoint
        for guid, endpoint in endpoints.items()
        if guid[:12] in others and endpoint.topic != names.NODES
    ]


def graph(
    peers: Iterable[Peer], writers: Mapping[bytes, Endpoint], readers: Mapping[bytes, Endpoint]
) -> Graph:
    """Return the graph of participants and their endpoints by GUID."""
    others = find_others(peers)
    published, subscribed = _count(writers, others), _count(readers, others)
    topics = [Topic(*key, published[key], subscribed[key]) for key in {**published, **subscribed}]
    return Graph(nodes=list_nodes(others.values()), topics=topics)


def _count(
    endpoints: Mapping[bytes, Endpoint], others: Container[bytes]
) -> Counter[tuple[str, str]]:
    """Return how many endpoints each topic and type has, without services."""
    return Counter(
        (names.topic_name(endpoint.topic), names.type_name(endpoint.type))
        for endpoint in list_endpoints(endpoints, others)
        if not names.is_service(endpoint.topic)
    )

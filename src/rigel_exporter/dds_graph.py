"""The content of a DDS domain's discovery, as one line of JSON.

    dds_graph.py CONFIG

Why: the exporter's modules read discovery, but only count endpoints; a picture needs to show which
node has which. CONFIG is JSON: the arguments of the exporter's Domain. Contract: the keys are those
that rosgraph/dds.py reads. It joins discovery until nothing new arrives, and leaves.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Mapping
from typing import Any

from rigel_exporter import dds_names as names
from rigel_exporter.dds import Domain
from rigel_exporter.dds_discovery import Endpoint
from rigel_exporter.dds_participant import Participant
from rigel_exporter.dds_peer import Peer
from rigel_exporter.dds_view import OURS

NAME = f"{OURS}graph reader"
#: Seconds of listening: at least, at most, and how long nothing new must arrive.
LEAST, MOST, QUIET = 2.0, 8.0, 1.0
TICK = 0.1


def describe(known: Participant) -> dict[str, Any]:
    """Return nodes, and endpoints with the names of their nodes."""
    return describe_graph(known.peers.values(), known.writers, known.readers)


def describe_graph(
    peers: Iterable[Peer], writers: Mapping[bytes, Endpoint], readers: Mapping[bytes, Endpoint]
) -> dict[str, Any]:
    """Return the nodes of participants, and each endpoint as [node, topic, type].

    Our own participants and discovery servers are left out, with their endpoints.
    """
    shown = [
        peer for peer in peers if not peer.announced.name.startswith(OURS) and not peer.is_server
    ]
    owners = {guid: name for peer in shown for name, own in peer.nodes.items() for guid in own}
    alone = {peer.announced.prefix: name_rest(peer) for peer in shown}
    nodes: dict[str, dict[str, Any]] = {}
    for peer in shown:
        for name in peer.nodes or ([] if peer.is_ros else [peer.name]):
            # A name of two participants is one node; one of them may be left over from a restart.
            known = nodes.get(name)
            if known is None or (peer.answers and not known["up"]):
                address = min(peer.sources, default="")
                nodes[name] = {"name": name, "address": address, "up": peer.answers}

    def list_endpoints(found: Mapping[bytes, Endpoint]) -> list[list[str]]:
        return sorted(
            [owners.get(guid, alone[guid[:12]]), endpoint.topic, endpoint.type]
            for guid, endpoint in found.items()
            if guid[:12] in alone and endpoint.topic != names.NODES
        )

    return {
        "nodes": [nodes[name] for name in sorted(nodes)],
        "writers": list_endpoints(writers),
        "readers": list_endpoints(readers),
        "pending": sum(1 for peer in shown if peer.is_ros and not peer.nodes),
    }


def name_rest(peer: Peer) -> str:
    """Return the name for those endpoints of a participant that none of its several nodes has."""
    return next(iter(peer.nodes)) if len(peer.nodes) == 1 else "" if peer.is_ros else peer.name


def listen(domain: Domain) -> dict[str, Any]:
    """Return what is known when nothing new has arrived for a while."""
    began = changed = time.monotonic()
    found = domain.inspect(describe)
    while True:
        time.sleep(TICK)
        now, before = time.monotonic(), found
        found = domain.inspect(describe)
        if found != before:
            changed = now
        calm = now - changed > QUIET and not found["pending"]
        if now - began > MOST or (now - began > LEAST and calm):
            return found


def main(config: str) -> None:
    """Print the graph."""
    domain = Domain(name=NAME, **json.loads(config))
    domain.start()
    try:
        found = listen(domain)
    finally:
        domain.close()
    sys.stdout.write(json.dumps(found, sort_keys=True) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1])

"""The content of a DDS domain's discovery, as one line of JSON.

    dds_graph.py CONFIG

Why: the exporter's modules read discovery, but only count endpoints; a picture needs to show which
node has which. CONFIG is JSON: the arguments of the exporter's Domain. Contract: the keys are those
that rigel_graph/dds.py and discovery/looks.py there read. It joins discovery until nothing new
arrives, and leaves.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping
from typing import Any

from rigel_exporter.dds import Domain
from rigel_exporter.dds_discovery import Endpoint
from rigel_exporter.dds_participant import Participant
from rigel_exporter.dds_peer import Peer
from rigel_exporter.dds_view import OURS, find_others, list_endpoints, list_nodes

NAME = f"{OURS}graph reader"
#: Seconds of listening: at least, at most, and how long nothing new must arrive.
LEAST, MOST, QUIET = 2.0, 8.0, 1.0
TICK = 0.1


def describe(known: Participant) -> dict[str, Any]:
    """Return the nodes of participants, each endpoint as [node, topic, type], and addresses."""
    others = find_others(known.peers.values())
    owners = {
        guid: name for peer in others.values() for name, own in peer.nodes.items() for guid in own
    }

    def name_owner(endpoint: Endpoint) -> str:
        peer = others[endpoint.guid[:12]]
        if endpoint.guid in owners or len(peer.nodes) == 1:
            return owners.get(endpoint.guid) or next(iter(peer.nodes))
        return "" if peer.is_ros else peer.name

    def describe_endpoints(endpoints: Mapping[bytes, Endpoint]) -> list[list[str]]:
        found = list_endpoints(endpoints, others)
        return sorted([name_owner(one), one.topic, one.type] for one in found)

    nodes = sorted(list_nodes(others.values()))
    return {
        "nodes": [{"name": one.name, "address": one.address, "up": one.up} for one in nodes],
        "writers": describe_endpoints(known.writers),
        "readers": describe_endpoints(known.readers),
        "addresses": sorted(
            {
                address
                for peer in others.values()
                if peer.answers
                for address in list_addresses(peer)
            }
        ),
        "pending": sum(1 for peer in others.values() if peer.is_ros and not peer.nodes),
    }


def list_addresses(peer: Peer) -> set[str]:
    """Return where a participant is: where it was heard from, or what a server says of it."""
    return peer.sources if peer.is_direct else {address for address, _ in peer.announced.meta}


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

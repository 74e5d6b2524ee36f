"""The ROS graph as a page draws it: boxes for nodes on their machines, topics between them; pure.

A node that crashes leaves the ROS graph, with its topics. Its box stays where it is, and its topics
stay as *lost* ones until it is back or removed: a picture that jumps when something breaks hides
what broke.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from rigel_graph.drawing import NOWHERE, Picture, make_picture, write_dot
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_ui.feed import Entries
from rigel_ui.nodes import DONE, is_well

#: What has room in each box and topic: the words of a state, and any rate.
WORDS, RATE = "machine unreachable", 9999.0
#: What a topic loses with its last node.
ENDLESS: Mapping[str, Any] = {"rate": "", "from": [], "to": [], "lost": []}


def make_boxes(
    nodes: Mapping[str, Mapping[str, Any]], graph: RosGraph | None, picture: Picture | None
) -> Entries:
    """Return the entries of boxes: the nodes of the graph, and those of the release without one.

    Args:
        nodes: the entries of the release's nodes, by workload.
        graph: as it was read last, None where it could not be read.
        picture: what is shown of it.
    """
    made: Entries = {}
    owners = {node.name: node.workload for node in graph.nodes} if graph else {}
    drawn: set[str] = set()
    for box in picture.boxes if picture else ():
        workload = owners.get(box.name, "")
        node = nodes.get(workload)
        if workload and node is None:
            continue  # of a workload that was removed after the graph was read
        drawn.add(workload)
        made[f"box/{box.name}"] = {
            "name": box.name,
            "workload": workload,
            # That of its present pod.
            "machine": (node["machine"] if node else "") or box.group,
            "note": "" if node else box.where,
            "wrong": box.wrong,
            "services": [
                {"name": service.name, "type": service.type}
                for service in (graph.services if graph else ())
                if service.is_public and box.name in service.providers
            ],
        }
    for workload, node in nodes.items():
        if workload not in drawn and not node["helper"]:
            made[f"box/{node['name']}"] = {
                "name": node["name"],
                "workload": workload,
                "machine": node["machine"] or NOWHERE,
                "note": "",
                "wrong": "",
                "services": [],
            }
    return made


def make_topics(graph: RosGraph, picture: Picture) -> Entries:
    topics = {topic.name: topic for topic in graph.topics}
    return {
        f"topic/{pill.name}": {
            "name": pill.name,
            "type": pill.type,
            "rate": pill.rate,
            "bad": pill.bad,
            "from": list(topics[pill.name].publishers),
            "to": list(topics[pill.name].subscribers),
            "lost": [],
        }
        for pill in picture.pills
    }


def list_away(nodes: Mapping[str, Mapping[str, Any]], present: Collection[str]) -> set[str]:
    """Return the names of nodes that are expected back; one that ran once is not.

    Args:
        nodes: the entries of the release's nodes, by workload.
        present: the names of nodes that have topics now.
    """
    return {
        node["name"]
        for node in nodes.values()
        if node["state"] != DONE and (not is_well(node) or node["name"] not in present)
    }


def keep_lost(old: Entries, new: Entries, away: Collection[str]) -> Entries:
    """Return topics with the ends that missing nodes had; those are in `lost`, too.

    Args:
        old: the topics before.
        new: the topics now.
        away: the names of nodes that are expected back.
    """
    made = {key: dict(topic) for key, topic in new.items()}
    for key, topic in old.items():
        for end in ("from", "to"):
            for name in topic[end]:
                if name in away and name not in made.get(key, {}).get(end, ()):
                    kept = made.setdefault(key, {**topic, **ENDLESS})
                    kept[end] = sorted([*kept[end], name])
                    kept["lost"] = sorted({*kept["lost"], name})
    return made


def describe(boxes: Entries, topics: Entries) -> str:
    """Return the DOT of boxes and topics: as `rigel graph` writes it, without what changes often.

    So a page lays its graph out again only if nodes, machines or connections are others.
    """
    names = {box["name"] for box in boxes.values()}

    def keep(ends: Iterable[str]) -> tuple[str, ...]:
        return tuple(name for name in ends if name in names)

    nodes = [GraphNode(box["name"], box["machine"], WORDS) for _, box in sorted(boxes.items())]
    shown = [
        GraphTopic(topic["name"], "", keep(topic["from"]), keep(topic["to"]), rate=RATE)
        for _, topic in sorted(topics.items())
        if keep((*topic["from"], *topic["to"]))
    ]
    return write_dot(make_picture(RosGraph(tuple(nodes), tuple(shown)), everything=True))

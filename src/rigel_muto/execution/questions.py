"""Answers about a ROS graph in the shapes of Muto's ROS 1 generation; pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_k8s.errors import UserError
from rigel_muto.agent.commands import Query

NOT_FOUND: Mapping[str, str] = {"status": "NOTFOUND"}


def answer(query: Query, graph: RosGraph) -> Any:
    """Return the answer to a question about nodes and topics.

    Raises:
        UserError: the question has no argument, or is not one that a graph answers.
    """
    if query.kind == "ros/node":
        return {"nodes": [_show_node(node, graph) for node in graph.nodes if node.registered]}
    if query.kind == "ros/topic":
        return {
            "pubs": [[t.name, t.type, list(t.publishers)] for t in graph.topics if t.publishers],
            "subs": [[t.name, t.type, list(t.subscribers)] for t in graph.topics if t.subscribers],
        }
    if query.kind == "ros/node/info":
        wanted = require(query, "node")
        nodes = [n for n in graph.nodes if n.registered and _is_called(n.name, wanted)]
        return _show_node(nodes[0], graph)["info"] if nodes else NOT_FOUND
    if query.kind == "ros/topic/info":
        wanted = require(query, "topic")
        topics = [topic for topic in graph.topics if _is_called(topic.name, wanted)]
        return _show_topic(topics[0], graph) if topics else NOT_FOUND
    raise UserError(f"{query.kind} is not supported by this agent")


def require(query: Query, name: str) -> str:
    """Return an argument of a question.

    Raises:
        UserError: it is missing.
    """
    value = query.arguments.get(name)
    if not isinstance(value, str) or not value:
        raise UserError(f'{query.kind} needs the argument "{name}", a text')
    return value


def _is_called(name: str, wanted: str) -> bool:
    return name.lstrip("/") == wanted.lstrip("/")


def _show_node(node: GraphNode, graph: RosGraph) -> dict[str, Any]:
    def list_topics(owners: str) -> list[dict[str, str]]:
        found = [topic for topic in graph.topics if node.name in getattr(topic, owners)]
        return [{"topic": topic.name, "type": topic.type} for topic in found]

    info = {
        "name": node.name,
        "pubs": list_topics("publishers"),
        "subs": list_topics("subscribers"),
        "services": [s.name for s in graph.services if node.name in s.providers],
    }
    return {"name": node.name, "info": info}


def _show_topic(topic: GraphTopic, graph: RosGraph) -> dict[str, Any]:
    """Return a topic with its nodes; `api` is the address of each, as far as it is known."""
    addresses = {node.name: node.address for node in graph.nodes}
    return {
        "topic": topic.name,
        "types": topic.type,
        "pubs": [{"publisher": n, "api": addresses.get(n, "")} for n in topic.publishers],
        "subs": [{"subscriber": n, "api": addresses.get(n, "")} for n in topic.subscribers],
    }

"""topic: messages and rates, read in a running pod."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rigel_graph import hz
from rigel_graph.commands.live import Live, open_live
from rigel_graph.tools import ROS1
from rigel_graph.types import GraphTopic
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import UserError
from rigel_k8s.settings import Settings

SHORT = 128  # elements of an array, as the tool of ROS 2 prints


def echo(
    settings: Settings, topic: str, *, job: str | None = None, **how: Any
) -> Iterator[Mapping[str, Any]]:
    """Yield the messages of a topic as `follow` does, of a release that is not connected yet."""
    found = release(settings, job)
    with found.cluster:
        yield from follow(found, topic, **how)


def follow(
    found: Release,
    topic: str,
    *,
    node: str | None = None,
    count: int | None = None,
    field: str = "",
    most: int | None = None,
    within: float | None = None,
) -> Iterator[Mapping[str, Any]]:
    """Yield the messages of a topic: `message`, `dropped` (in all), `shortened`.

    Args:
        node: in whose pod it is subscribed to.
        field: the part of each message, a.b; empty for all.
        most: elements of an array and characters of a text, None for all.
        within: seconds in which each message must come, None for no limit.

    Raises:
        UserError: there is no such topic, field or node.
        ClusterError: no pod can subscribe to it, no message came, or the connection has ended.
    """
    live = open_live(found)
    meant = live.find_topic(topic)
    request = {
        "do": "echo",
        **describe(meant),
        "field": field.split(".") if field else [],
        "most": most,
        "count": count,
        "within": within,
    }
    yield from live.ask(request, meant.publishers, node, command_of(live, "echo", meant))


def describe(topic: GraphTopic) -> dict[str, Any]:
    """Return a topic for a request.

    Raises:
        UserError: its type is unknown.
    """
    if not topic.type:
        raise UserError(f"the type of {topic.name} is unknown: no node publishes it")
    return {"topic": topic.name, "type": topic.type, "publishers": len(topic.publishers)}


def command_of(live: Live, verb: str, topic: GraphTopic) -> str:
    """Return the line of ROS' own tool."""
    return f"{'rostopic' if live.tool is ROS1 else 'ros2 topic'} {verb} {topic.name}"


def hz_of(settings: Settings, topic: str, job: str | None = None) -> Iterator[hz.Beat | str]:
    """Yield a beat of a topic each second; a text before the first, if it has to be subscribed to.

    Raises: as echo.
    """
    found = release(settings, job)
    with found.cluster:
        live = open_live(found)
        meant = live.find_topic(topic)
        try:
            yield from hz.measure(found.cluster, found.id, meant, dds=live.generation != "1")
        except hz.NoSource:
            yield f"no publisher of {meant.name} counts its messages: counted by a subscriber"
            request = {"do": "count", **describe(meant)}
            for one in live.ask(request, meant.publishers, None, command_of(live, "hz", meant)):
                yield hz.Beat(one["rate"], one["gap"])

"""The result of a look at a ROS graph: plain data, the same from ROS 1, ROS 2 and DDS.

It contains the current state. standing.py decides for both which nodes were seen before or are
expected, and what is above the limits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from rigel_exporter.messages import Reader
from rigel_exporter.samples import Subscription


class Node(NamedTuple):
    """A ROS node.

    Attributes:
        name: with its namespace, `/talker`.
        up: registered (ROS 1), discovered (DDS) or running (ROS 2), and it answers.
        registered: it is registered at the master, or discovered.
        address: where it is, for people: a URI or an IP address.
        missing: how many of its topics are not registered at the master.
        stands: seconds for which its process has not looked for work; None if that is unknown.
        process: an address that its pod keeps, and which process there it is; empty if unknown.
    """

    name: str
    up: bool
    registered: bool
    address: str = ""
    missing: int = 0
    stands: float | None = None
    process: tuple[str, str] | tuple[()] = ()


class Topic(NamedTuple):
    """A topic, by its ROS name and type; its counts are nodes (ROS 1) or endpoints (DDS)."""

    name: str
    type: str
    publishers: int
    subscribers: int


class Traffic(NamedTuple):
    """What a node itself counted on a topic since it started; DDS without ROS counts nothing.

    Attributes:
        direction: `published` or `received`.
        size: bytes: in ROS 1 with the header at the beginning of a connection, in ROS 2 of messages
            that the node itself has serialized.
        matched: partners that its middleware has found. This and the rest are ROS 2's.
        silence: seconds since the last message, None before the first one.
        gap: the longest time between two messages of the last minute, in seconds.
        age: seconds from the publication of the last message to its taking.
        refused: calls that the middleware answered with an error.
        dropped: messages that did not pass while the node waited to take over, or was replaced.
    """

    node: str
    topic: str
    direction: str
    messages: int
    size: int
    matched: int | None = None
    silence: float | None = None
    gap: float = 0.0
    age: float = 0.0
    refused: int = 0
    dropped: int = 0


def count_messages(parts: Sequence[Traffic]) -> int | None:
    """Return the messages on a topic: those published, else those of who heard most, None of none.

    Args:
        parts: the traffic of the topic.
    """
    sent = [part.messages for part in parts if part.direction == "published"]
    return sum(sent) if sent else max((part.messages for part in parts), default=None)


class Master(NamedTuple):
    """The ROS 1 master: whether it answers, its process, and its /run_id ("": not set yet)."""

    up: bool
    pid: int = 0
    run: str = ""


class Graph(NamedTuple):
    """The current graph.

    Attributes:
        master: None if this ROS has no master.
        dropped: how many `nodes` exist but were not asked, since they are above the limit.
    """

    nodes: Sequence[Node] = ()
    topics: Sequence[Topic] = ()
    traffic: Sequence[Traffic] = ()
    master: Master | None = None
    dropped: Mapping[str, int] = {}


class Half(Protocol):
    """A ROS graph: ROS 1's by its master, ROS 2's by its processes' notes, or a DDS domain's."""

    #: Whether its traffic has what would otherwise be measured by subscribing to named topics.
    counts: bool

    def look(self) -> Graph:
        """Return the current graph; takes at most seconds, even if nodes do not answer."""

    def subscribe(self, topic: str, keep: int = 0) -> Subscription:
        """Subscribe to a topic, and keep that many of its latest payloads."""

    def read(self, payload: bytes) -> Reader:
        """Return a reader of a kept payload."""

    def close(self) -> None:
        """Leave the graph with all subscribers."""

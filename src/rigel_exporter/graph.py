"""The result of a look at a ROS graph: plain data, the same from the ROS 1 and the DDS half.

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
        up: registered (ROS 1) or discovered (DDS), and it answers.
        registered: it is registered at the master, or discovered.
        address: where it is, for people: a URI or an IP address.
        missing: how many of its topics are not registered at the master.
    """

    name: str
    up: bool
    registered: bool
    address: str = ""
    missing: int = 0


class Topic(NamedTuple):
    """A topic, by its ROS name and type; its counts are nodes (ROS 1) or endpoints (DDS)."""

    name: str
    type: str
    publishers: int
    subscribers: int


class Traffic(NamedTuple):
    """What a node itself counted on a topic since it started; only ROS 1 nodes count.

    Attributes:
        direction: `published` or `received`.
        size: bytes as it counts them, with the header at the beginning of a connection.
    """

    node: str
    topic: str
    direction: str
    messages: int
    size: int


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
    """A ROS graph: ROS 1's by its master, or a DDS domain's."""

    def look(self) -> Graph:
        """Return the current graph; takes at most seconds, even if nodes do not answer."""

    def subscribe(self, topic: str, keep: int = 0) -> Subscription:
        """Subscribe to a topic, and keep that many of its latest payloads."""

    def read(self, payload: bytes) -> Reader:
        """Return a reader of a kept payload."""

    def close(self) -> None:
        """Leave the graph with all subscribers."""

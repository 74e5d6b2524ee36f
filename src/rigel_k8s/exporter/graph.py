"""What a look at a ROS graph finds: plain data that ROS 1's half and DDS' half both give.

It holds what is seen now. That a node was seen before, or is expected, and what is too much to be
told, is judged above it, once for both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol


class Node(NamedTuple):
    """A ROS node.

    Attributes:
        name: with its namespace, `/talker`.
        up: registered (ROS 1) or discovered (DDS), and it answers.
        registered: the master, or the discovery, knows it.
        address: where it is, for people: a URI or an IP address.
        missing: what it says it publishes or subscribes, and the master does not know.
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
    """What a node itself counted on a topic since it started; only ROS 1's nodes count.

    Attributes:
        direction: `published` or `received`.
        size: bytes, as it counts them: with the header that a connection begins with.
    """

    node: str
    topic: str
    direction: str
    messages: int
    size: int


class Master(NamedTuple):
    """The ROS 1 master: whether it answers, its process, and its /run_id ("": none is set yet)."""

    up: bool
    pid: int = 0
    run: str = ""


class Graph(NamedTuple):
    """What there is now.

    Attributes:
        master: None where ROS has none.
        dropped: what is there and was not asked, since it is too much: `nodes`, how many.
    """

    nodes: Sequence[Node] = ()
    topics: Sequence[Topic] = ()
    traffic: Sequence[Traffic] = ()
    master: Master | None = None
    dropped: Mapping[str, int] = {}


class Samples(NamedTuple):
    """What a subscriber has received since it began.

    Attributes:
        messages: how many, across reconnects.
        size: the bytes of their payloads.
        last: when the latest came, in seconds since 1970; None for never.
        stamp: the latest header's stamp in seconds (ROS time); None where there is no header.
        payloads: the latest messages as they came, oldest first, where they are kept. ROS 1's
            serialization, or CDR with its four bytes of encapsulation.
    """

    messages: int = 0
    size: int = 0
    last: float | None = None
    stamp: float | None = None
    payloads: Sequence[bytes] = ()


class Subscriber(Protocol):
    """One named topic, heard best effort; it goes on through restarts of publishers."""

    def samples(self) -> Samples:
        """Return the counts up to now; kept payloads are handed out once."""

    def close(self) -> None:
        """Leave the graph, and say so to it."""


class Half(Protocol):
    """A ROS graph: ROS 1's by its master, or a DDS domain's."""

    def look(self) -> Graph:
        """Return what is there now; takes seconds at most, whatever has stopped or gone."""

    def subscribe(self, topic: str, keep: int = 0) -> Subscriber:
        """Begin to hear a topic, and keep that many of its latest payloads."""

    def diagnostics(self, payload: bytes) -> Sequence[tuple[str, str, int]]:
        """Return (name, hardware id, level) of each status in a DiagnosticArray."""

    def clock(self, payload: bytes) -> float:
        """Return the time of a Clock message in seconds."""

    def transforms(self, payload: bytes) -> Sequence[tuple[str, str, float]]:
        """Return (parent, child, stamp in seconds) of each transform in a TFMessage."""

    def close(self) -> None:
        """Leave the graph with all subscribers."""

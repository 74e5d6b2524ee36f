"""The ROS 1 half: the graph from the master and the nodes, and topics by TCPROS.

Only `subscribe` subscribes: the rates of other topics come from the nodes' own counts. It registers
at the master for the first named topic, and unregisters at the end.
"""

from __future__ import annotations

import asyncio
import math
import os
import threading
import time
from collections.abc import Coroutine, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeVar

from rigel_exporter import ros1_messages
from rigel_exporter.graph import Graph, Master, Node, Topic
from rigel_exporter.ros1_calls import Conversation, Refused
from rigel_exporter.ros1_node import Slave
from rigel_exporter.ros1_topic import Hearing
from rigel_exporter.ros1_traffic import Ledger
from rigel_exporter.ros1_view import MASTER, Replies, View, ask_master, ask_nodes, look_up_nodes
from rigel_inpod.rosrpc import CallFailed

#: The names of all exporters begin with it; exporters are not in the metrics.
NAME = "/ros_exporter"
#: Seconds after which the master is asked for a node's address again, even if the node answers.
_FRESH = 60.0
#: Seconds that a look takes at most, if every deadline in it is missed.
_LOOK = 30.0

T = TypeVar("T")


class Ros1:
    """A ROS 1 graph, by its master."""

    def __init__(
        self, master_uri: str, *, name: str = NAME, first: Iterable[str] = (), most: int = 200
    ) -> None:
        """Ask nothing yet.

        Args:
            master_uri: http://HOST:PORT.
            name: the exporter's own ROS name, which begins with NAME.
            first: names of nodes that are asked even above the limit.
            most: how many nodes are asked at most.
        """
        self._uri, self._name = master_uri, name
        self._first, self._most = frozenset(first), most
        self._places: dict[str, _Place] = {}
        self._ledger = Ledger()
        self._hearings: dict[str, Hearing] = {}
        self._lock = threading.Lock()
        self._slave: Slave | None = None
        self._host = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or ""
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="ros1", daemon=True)
        self._thread.start()

    # -- the graph --

    def look(self) -> Graph:
        """Return the current graph; takes at most seconds, even if nodes do not answer."""
        return self._run(self._look())

    async def _look(self) -> Graph:
        try:
            view = await ask_master(self._uri, self._name)
        except CallFailed:
            return await self._ask_without_master()
        # The expected ones first, then the others by name.
        known = sorted(_hide_exporters(view.nodes), key=lambda n: (n not in self._first, n))
        names = known[: self._most]
        await self._find(names, view)
        replies = await self._ask(names)
        later = await self._ask_again(view, replies)
        self._count(replies)
        await self._hear(view)
        return Graph(
            nodes=self._nodes(names, replies, (view, later)),
            topics=_topics(view, self._hearings),
            traffic=self._ledger.totals(),
            master=Master(up=True, pid=view.pid, run=view.run),
            dropped={"nodes": len(_hide_exporters(view.nodes)) - len(names)},
        )

    async def _ask_without_master(self) -> Graph:
        """Return the answers of earlier nodes; without the master, their state is unknown."""
        replies = await self._ask(())
        self._count(replies)
        return Graph(
            nodes=self._nodes((), replies, ()),
            traffic=self._ledger.totals(),
            master=Master(up=False),
        )

    async def _find(self, names: Sequence[str], view: View) -> None:
        """Look up the addresses of nodes that are new, silent, or were not looked up lately."""
        now = time.monotonic()
        wanted = [n for n in names if n not in self._places or self._places[n].asked + _FRESH < now]
        found = await look_up_nodes(self._uri, self._name, wanted) if wanted else {}
        for name, uri in found.items():
            old = self._places.get(name)
            pid = old.pid if old and old.uri == uri else ""
            self._places[name] = _Place(uri, now, pid)
        taken = {self._places[name].uri for name in names if name in self._places}
        for name in [n for n, place in self._places.items() if n not in view.nodes]:
            if self._places[name].uri in taken:  # another node has its place
                del self._places[name]

    async def _ask(self, names: Sequence[str]) -> dict[str, Replies]:
        """Return the answers of nodes: those in `names`, and those that were registered before."""
        uris = {name: place.uri for name, place in self._places.items()}
        replies = await ask_nodes(uris, self._name)
        for name, answer in replies.items():
            place = self._places[name]
            if answer.answers and (name in names or not place.pid):
                place.pid = answer.pid
            elif not answer.answers:
                place.asked = -math.inf  # it may have moved
        for name in replies.keys() - set(names):
            # Another node may answer at a node's old address.
            if not replies[name].answers or replies[name].pid != self._places[name].pid:
                del self._places[name]
        return replies

    async def _ask_again(self, view: View, replies: Mapping[str, Replies]) -> View:
        """Return the master's state again if a node may have registered meanwhile."""
        if not any(_count_missing(name, answer, (view,)) for name, answer in replies.items()):
            return view
        try:
            return await ask_master(self._uri, self._name)
        except CallFailed:
            return view

    def _nodes(
        self, names: Sequence[str], replies: Mapping[str, Replies], views: Sequence[View]
    ) -> list[Node]:
        """Return the registered nodes, and the orphans: alive, but not registered."""
        orphans = [name for name in self._places if name not in names]
        return [
            self._node(name, replies.get(name) or Replies(), views, known=True) for name in names
        ] + [
            self._node(name, replies[name], views, known=False)
            for name in orphans
            if name in replies
        ]

    def _node(self, name: str, replies: Replies, views: Sequence[View], *, known: bool) -> Node:
        place = self._places.get(name)
        return Node(
            name,
            up=known and replies.answers,
            registered=known,
            address=place.uri if place else "",
            missing=_count_missing(name, replies, views),
        )

    def _count(self, replies: Mapping[str, Replies]) -> None:
        for name, answer in replies.items():
            if answer.stats is not None and name in self._places:
                with suppress(
                    ValueError, TypeError, LookupError
                ):  # no statistics: of this node alone
                    self._ledger.add(name, self._places[name].uri, answer.stats)
        self._ledger.keep(self._places)

    # -- named topics --

    def subscribe(self, topic: str, keep: int = 0) -> Hearing:
        """Subscribe to a topic at the next look, and keep that many of its latest payloads."""
        with self._lock:
            if self._slave is None:
                self._slave = Slave(
                    self._uri, lambda: list(self._hearings), self._update_publishers
                )
            hearing = Hearing(topic, self._name, keep, self._leave)
            self._hearings[topic] = hearing
        return hearing

    async def _hear(self, view: View) -> None:
        """Register topics that are not registered at the master (any more); follow publishers."""
        unknown = []
        for topic, hearing in list(self._hearings.items()):
            if self._name in view.subscribers.get(topic, ()):
                names = view.publishers.get(topic, frozenset())
                hearing.publishers(self._places[n].uri for n in names if n in self._places)
            else:
                unknown.append(hearing)
        if unknown:
            await self._register(unknown, self._api(view.local_address))

    async def _register(self, hearings: Sequence[Hearing], api: str) -> None:
        """Subscribe to topics; one that fails is tried again at the next look."""
        talk = Conversation(self._uri, self._name, MASTER)
        try:
            for hearing in hearings:
                with suppress(Refused):  # an invalid name does not stop the others
                    found = await talk.call("registerSubscriber", hearing.topic, "*", api)
                    hearing.publishers(found)
        except CallFailed:
            pass
        finally:
            talk.close()

    def _api(self, local_address: str) -> str:
        assert self._slave is not None  # it exists from the first topic on
        return f"http://{self._host or local_address}:{self._slave.port}/"

    def _update_publishers(self, topic: str, publishers: Sequence[str]) -> None:
        if hearing := self._hearings.get(topic):
            hearing.publishers(publishers)

    def _leave(self, hearing: Hearing) -> None:
        self._hearings.pop(hearing.topic, None)
        self._run(self._unregister([hearing.topic]))

    async def _unregister(self, topics: Sequence[str]) -> None:
        talk = Conversation(self._uri, self._name, MASTER)
        try:
            for topic in topics:
                await talk.call(
                    "unregisterSubscriber", topic, self._api(await _find_own_address(talk))
                )
        except CallFailed:
            pass  # the master has ended too
        finally:
            talk.close()

    # -- what messages mean --

    def diagnostics(self, payload: bytes) -> Sequence[tuple[str, str, int]]:
        """Return (name, hardware id, level) of each status in a DiagnosticArray."""
        return ros1_messages.diagnostics(payload)

    def clock(self, payload: bytes) -> float:
        """Return the time of a Clock message in seconds."""
        return ros1_messages.clock(payload)

    def transforms(self, payload: bytes) -> Sequence[tuple[str, str, float]]:
        """Return (parent, child, stamp in seconds) of each transform in a TFMessage."""
        return ros1_messages.transforms(payload)

    def close(self) -> None:
        """Leave the graph with all subscribers; nothing runs on afterwards."""
        hearings = list(self._hearings.values())
        self._hearings.clear()
        for hearing in hearings:
            hearing.publishers(())
        try:
            self._run(self._unregister([hearing.topic for hearing in hearings]))
        finally:
            if self._slave:
                self._slave.close()
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(_LOOK)
            self._loop.close()

    def _run(self, coroutine: Coroutine[Any, Any, T]) -> T:
        future = asyncio.run_coroutine_threadsafe(coroutine, self._loop)
        try:
            return future.result(_LOOK)
        finally:
            future.cancel()  # only has an effect if it took too long


class _Place:
    """A node's URI, when the master was asked for it, and its process at the registration."""

    def __init__(self, uri: str, asked: float, pid: str) -> None:
        self.uri, self.asked, self.pid = uri, asked, pid


async def _find_own_address(talk: Conversation) -> str:
    """Return the own address as the master sees it."""
    await talk.call("getPid")
    return talk.local_address or ""


def _hide_exporters(names: Iterable[str]) -> set[str]:
    """Return the names without exporters'."""
    return {name for name in names if name != NAME and not name.startswith(f"{NAME}_")}


def _topics(view: View, named: Iterable[str]) -> list[Topic]:
    found = {*view.publishers, *view.subscribers}
    made = [
        Topic(
            name,
            view.types.get(name, ""),
            len(_hide_exporters(view.publishers.get(name, ()))),
            len(_hide_exporters(view.subscribers.get(name, ()))),
        )
        for name in sorted(found)
    ]
    return [topic for topic in made if topic.publishers or topic.subscribers or topic.name in named]


def _count_missing(name: str, replies: Replies, views: Sequence[View]) -> int:
    """Return how many of a node's topics none of the views contains."""
    parts = [(replies.publishes, "publishers"), (replies.subscribes, "subscribers")]
    if not views:
        return 0
    return sum(
        not any(name in getattr(view, part).get(topic, ()) for view in views)
        for topics, part in parts
        for topic in topics
    )

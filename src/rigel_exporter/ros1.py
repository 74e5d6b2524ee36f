"""The ROS 1 half: the graph from the master and the nodes, and topics by TCPROS.

Only `subscribe` subscribes: the rates of other topics come from the nodes' own counts. It registers
at the master for the first named topic, and unregisters at the end.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress

from rigel_exporter import messages
from rigel_exporter.graph import Graph, Master, Node, Topic
from rigel_exporter.ros1_node import Slave
from rigel_exporter.ros1_topic import TopicSubscription
from rigel_exporter.ros1_traffic import Ledger
from rigel_exporter.ros1_view import (
    Replies,
    View,
    ask_master,
    ask_nodes,
    connect_master,
    look_up_nodes,
)
from rigel_exporter.samples import Subscription
from rigel_inpod import rosrpc
from rigel_inpod.rosrpc import CallFailed, Refused

#: The names of all exporters begin with it; exporters are not in the metrics.
NAME = "/ros_exporter"
#: Seconds after which the master is asked for a node's address again, even if the node answers; and
#: for which an orphan may be silent.
_FRESH = 60.0


class Ros1:
    """A ROS 1 graph, by its master."""

    counts = False

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
        self._subscriptions: dict[str, TopicSubscription] = {}
        self._lock = threading.Lock()
        self._slave: Slave | None = None
        self._host = os.environ.get("ROS_HOSTNAME") or os.environ.get("ROS_IP") or ""
        self._api = ""  # the URI of our own slave API, once it is registered

    # -- the graph --

    def look(self) -> Graph:
        """Return the current graph; takes at most seconds, even if nodes do not answer."""
        try:
            view = ask_master(self._uri, self._name)
        except CallFailed:
            return self._ask_without_master()
        # The expected ones first, then the others by name.
        known = sorted(_hide_exporters(view.nodes), key=lambda n: (n not in self._first, n))
        names = known[: self._most]
        self._find(names, view)
        replies = self._ask(names)
        later = self._ask_again(view, replies)
        self._count(replies)
        self._follow(view)
        return Graph(
            nodes=self._nodes(names, replies, (view, later)),
            topics=_topics(view, self._subscriptions),
            traffic=self._ledger.totals(),
            master=Master(up=True, pid=view.pid, run=view.run),
            dropped={"nodes": len(_hide_exporters(view.nodes)) - len(names)},
        )

    def _ask_without_master(self) -> Graph:
        """Return the answers of earlier nodes; without the master, their state is unknown."""
        replies = self._ask(())
        self._count(replies)
        return Graph(
            nodes=self._nodes((), replies, ()),
            traffic=self._ledger.totals(),
            master=Master(up=False),
        )

    def _find(self, names: Sequence[str], view: View) -> None:
        """Look up the addresses of nodes that are new, silent, or were not looked up lately."""
        now = time.monotonic()
        wanted = [n for n in names if n not in self._places or self._places[n].asked + _FRESH < now]
        found = look_up_nodes(self._uri, self._name, wanted) if wanted else {}
        for name, uri in found.items():
            old = self._places.get(name)
            pid = old.pid if old and old.uri == uri else ""
            self._places[name] = _Place(uri, now, pid)
        taken = {self._places[name].uri for name in names if name in self._places}
        for name in [n for n, place in self._places.items() if n not in view.nodes]:
            if self._places[name].uri in taken:  # another node has its place
                del self._places[name]

    def _ask(self, names: Sequence[str]) -> dict[str, Replies]:
        """Return the answers of nodes: those in `names`, and those that were registered before."""
        now = time.monotonic()
        uris = {name: place.uri for name, place in self._places.items()}
        replies = ask_nodes(uris, self._name)
        for name, answer in replies.items():
            place = self._places[name]
            if answer.answers:
                place.answered = now
                if name in names or not place.pid:
                    place.pid = answer.pid
                gone = answer.pid != place.pid  # another node answers at its old address
            else:
                place.asked = -math.inf  # it may have moved
                gone = place.answered + _FRESH < now  # one that is busy is not
            if gone and name not in names:
                del self._places[name]
        return replies

    def _ask_again(self, view: View, replies: Mapping[str, Replies]) -> View:
        """Return the master's state again if a node may have registered meanwhile."""
        if not any(_count_missing(name, answer, (view,)) for name, answer in replies.items()):
            return view
        try:
            return ask_master(self._uri, self._name)
        except CallFailed:
            return view

    def _nodes(
        self, names: Sequence[str], replies: Mapping[str, Replies], views: Sequence[View]
    ) -> list[Node]:
        """Return the registered nodes, and the orphans: alive, but not registered."""
        orphans = [n for n in self._places if replies[n].answers and n not in names]
        found = [(name, replies.get(name) or Replies()) for name in [*names, *orphans]]
        return [
            Node(
                name,
                up=name in names and reply.answers,
                registered=name in names,
                address=self._places[name].uri if name in self._places else "",
                missing=_count_missing(name, reply, views),
                process=self._places[name].process if reply.answers else (),
            )
            for name, reply in found
        ]

    def _count(self, replies: Mapping[str, Replies]) -> None:
        for name, answer in replies.items():
            if answer.stats is not None and name in self._places:
                with suppress(ValueError, TypeError, LookupError):  # this node's are none
                    self._ledger.add(name, self._places[name].uri, answer.stats)
        self._ledger.keep(self._places)

    # -- named topics --

    def subscribe(self, topic: str, keep: int = 0) -> TopicSubscription:
        """Subscribe to a topic at the next look, and keep that many of its latest payloads."""
        with self._lock:
            if self._slave is None:
                self._slave = Slave(
                    self._uri, lambda: list(self._subscriptions), self._take_publishers
                )
            made = TopicSubscription(topic, keep, self._leave, self._name)
            self._subscriptions[topic] = made
        return made

    def read(self, payload: bytes) -> messages.Reader:
        """Return a reader of a kept payload."""
        return messages.ros1(payload)

    def _follow(self, view: View) -> None:
        """Register topics that are not registered at the master (any more); follow publishers."""
        unknown = []
        for topic, subscription in list(self._subscriptions.items()):
            if self._name in view.subscribers.get(topic, ()):
                names = view.publishers.get(topic, frozenset())
                subscription.follow(self._places[n].uri for n in names if n in self._places)
            else:
                unknown.append(subscription)
        if unknown and self._slave:
            self._api = f"http://{self._host or view.local_address}:{self._slave.port}/"
            self._register(unknown)

    def _register(self, subscriptions: Sequence[TopicSubscription]) -> None:
        """Subscribe to topics; one that fails is tried again at the next look."""
        with suppress(CallFailed), connect_master(self._uri, self._name) as master:
            for one in subscriptions:
                with suppress(Refused):  # an invalid name does not stop the others
                    one.follow(master.ask("registerSubscriber", one.topic, "*", self._api))

    def _take_publishers(self, topic: str, publishers: Sequence[str]) -> None:
        if subscription := self._subscriptions.get(topic):
            subscription.follow(publishers)

    def _leave(self, subscription: Subscription) -> None:
        self._subscriptions.pop(subscription.topic, None)
        self._unregister([subscription.topic])

    def _unregister(self, topics: Sequence[str]) -> None:
        with suppress(CallFailed), connect_master(self._uri, self._name) as master:
            for topic in topics:
                master.ask("unregisterSubscriber", topic, self._api)

    def close(self) -> None:
        """Leave the graph with all subscribers."""
        subscriptions = list(self._subscriptions.values())
        self._subscriptions.clear()
        for subscription in subscriptions:
            subscription.follow(())
        self._unregister([subscription.topic for subscription in subscriptions])
        if self._slave:
            self._slave.close()


class _Place:
    """A node's URI, when the master was asked for it, and its process at the registration."""

    def __init__(self, uri: str, asked: float, pid: str) -> None:
        self.uri, self.asked, self.answered, self.pid = uri, asked, asked, pid

    @property
    def process(self) -> tuple[str, str]:
        """The node's host, and a name of its process there: its port is another at each start."""
        host, port = rosrpc.split(self.uri)
        return host, f"{port} {self.pid}"


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

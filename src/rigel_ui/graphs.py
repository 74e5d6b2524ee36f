"""The ROS graph as pages show it: read when pods have changed, and now and then for open pages."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, timezone
from typing import Any

from rigel_graph.commands.graph import LiveGraph, picture_of
from rigel_graph.types import RosGraph
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.objects.facts import stays_ready
from rigel_k8s.objects.refs import Manifest
from rigel_ui.boxes import describe, keep_lost, list_away, make_boxes, make_topics
from rigel_ui.feed import Entries, Feed

CALM = 1.5  # seconds after a change of pods before the graph is read
AGE = 30.0  # seconds after which it is read again while a page is open


class GraphReader:
    """Reads the ROS graph in a thread of its own, and publishes it with the nodes.

    Args:
        read: reads the graph.
    """

    def __init__(self, feed: Feed, read: Callable[[], LiveGraph]) -> None:
        self._feed, self._look = feed, read
        self._over = threading.Event()
        self._wake = threading.Event()
        self._pods: frozenset[tuple[str, bool]] | None = None
        self._due = 0.0
        self._nodes: Mapping[str, Any] = {}
        self._found: LiveGraph | None = None
        self._rates: Entries = {}

    def show(self, nodes: Mapping[str, Any], pods: Iterable[Manifest]) -> None:
        """Publish nodes; if other pods are ready than before, the graph has changed."""
        self._nodes = nodes
        ready = frozenset((pod["metadata"]["uid"], stays_ready(pod)) for pod in pods)
        if ready != self._pods:
            self._pods = ready
            self._due = time.monotonic() + CALM
            self._wake.set()
        self._draw()

    def close(self) -> None:
        """End, without waiting for an answer."""
        self._over.set()
        self._wake.set()

    def run(self) -> None:
        """Read until the end."""
        read = 0.0
        while not self._over.is_set():
            due = self._due
            self._wake.wait(max(0.02, due - time.monotonic()) if due else 1.0)
            self._wake.clear()
            now = time.monotonic()
            old = self._feed.watched and now - read > AGE
            if self._pods and ((self._due and now >= self._due) or old):
                self._due = 0.0
                self._read()
                read = time.monotonic()

    def _read(self) -> None:
        state: dict[str, Any] = {"message": "", "read": write_now()}
        graph, begun = None, time.time()
        try:
            self._found = self._look()
        except RigelK8sError as error:
            old: Mapping[str, Any] = self._feed.get("graph") or {}
            state = {"message": error.message, "read": old.get("read", "")}
        else:
            graph = self._found.graph
            problems = [problem.to_json() for problem in self._found.problems]
            self._feed.publish("problems", {"problems": problems})
            self._draw()
        if not self._over.is_set():
            self._rates = add_rates(self._rates, graph, begun, time.time())
            self._feed.publish("rates", self._rates)
            self._feed.publish("graph", {"graph": state})

    def _draw(self) -> None:
        """Publish boxes and topics, from the nodes and the graph that was read last."""
        read, nodes = self._found, self._nodes
        graph = read.graph if read else None
        picture = picture_of(read) if read else None
        boxes = make_boxes(nodes, graph, picture)
        topics = self._feed.list_group("topic")
        if graph is not None and picture is not None:
            present = {
                name for topic in graph.topics for name in (*topic.publishers, *topic.subscribers)
            }
            away = list_away(nodes, present)
            topics = keep_lost(topics, make_topics(graph, picture), away)
        self._feed.publish("box", boxes)
        self._feed.publish("topic", topics)
        self._feed.publish("dot", {"dot": {"text": describe(boxes, topics)}})


def write_now() -> str:
    """Return the present time as Kubernetes writes it."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


KEPT = 600.0  # seconds
MOST = 60  # readings; pods that crash again and again cause many


def add_rates(old: Entries, graph: RosGraph | None, begun: float, ended: float) -> Entries:
    """Return the entries of readings with a new one, without those that are too old.

    Args:
        graph: None if it could not be read.
        begun, ended: when it was read, in seconds since 1970; on a busy cluster it takes a while.
    """
    topics = graph.topics if graph else ()
    rates = {
        topic.name: round(topic.rate, 2 if topic.rate >= 1 else 4)
        for topic in topics
        if topic.is_public and topic.rate is not None
    }
    made = {**old, f"rates/{begun}": {"begun": begun, "ended": ended, "of": rates}}
    return {key: one for key, one in list(made.items())[-MOST:] if one["begun"] > begun - KEPT}

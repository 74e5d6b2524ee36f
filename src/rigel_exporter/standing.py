"""Compares the graph with what is expected and what was seen before, with limits.

It takes in looks and makes none itself. `Standing` is about nodes and topics, with times as seconds
since 1970; `Contract` about what an application expects of topics.
"""

from __future__ import annotations

import re
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeVar

from rigel_exporter.expecting import OK, UNKNOWN, Expected, Finding, Reading, judge
from rigel_exporter.graph import Graph, Master, Node, Topic, Traffic, count_messages
from rigel_exporter.metrics import Sample

#: How many of each are exported at most; ros_exporter_dropped counts the rest.
NODES, TOPICS, TRAFFIC = 200, 500, 2000
#: Seconds for which a node that is not expected is exported as missing.
REMEMBERED = 3600.0
#: The form of ROS' anonymous names, which never occur again: /talker_1234_1700000000000.
_ANONYMOUS = re.compile(r"_\d+_\d{10,}$")
#: Seconds over which the rate of a topic of the contract is measured.
WINDOW = 30.0

T = TypeVar("T")


class Standing:
    """The looks so far."""

    def __init__(
        self,
        expected: Mapping[str, str],
        known: Mapping[str, str],
        named: Iterable[str],
        once: Iterable[str] = (),
    ) -> None:
        """Begin without a look.

        Args:
            expected: ROS names of nodes that must exist, and the workload of each.
            known: the workloads of others.
            named: topics that are exported even above the limit.
            once: names of nodes that end, and are not missing afterwards.
        """
        self._expected, self._named, self._once = dict(expected), frozenset(named), frozenset(once)
        self._workloads = {**known, **expected}
        self._graph, self._now = Graph(), 0.0
        self._seen: dict[str, float] = {}
        self._processes: dict[str, tuple[str, str]] = {}
        self._restarted: Counter[str] = Counter()
        self._dropped: dict[str, int] = {}
        self._master: Master | None = None
        self._master_since = 0.0
        self._restarts = 0

    def take(self, graph: Graph, now: float) -> None:
        """Take in a look."""
        nodes = _take_first(graph.nodes, NODES, lambda n: (n.name not in self._expected, n.name))
        topics = _take_first(graph.topics, TOPICS, lambda t: (t.name not in self._named, t.name))
        much = {topic.name for topic in graph.topics} - {topic.name for topic in topics}
        traffic = [part for part in graph.traffic if part.topic not in much][:TRAFFIC]
        self._dropped = {
            "nodes": len(graph.nodes) - len(nodes) + graph.dropped.get("nodes", 0),
            "topics": len(graph.topics) - len(topics) + graph.dropped.get("topics", 0),
            "traffic": len(graph.traffic) - len(traffic),
        }
        self._graph = graph._replace(nodes=nodes, topics=topics, traffic=traffic)
        self._now = now
        self._remember(nodes, now)
        if graph.master and graph.master.up:
            self._meet(graph.master, now)

    def _remember(self, nodes: Iterable[Node], now: float) -> None:
        lasting = (node.name for node in nodes if node.name not in self._once)
        seen = {name: now for name in lasting if not _ANONYMOUS.search(name)}
        self._seen = {n: when for n, when in self._seen.items() if when + REMEMBERED > now} | seen
        processes = {node.name: node.process for node in nodes if node.process}
        for name in processes.keys() & seen.keys():
            old, new = self._processes.get(name, processes[name]), processes[name]
            # At another address it is in another pod: an update has replaced it.
            self._restarted[name] += old != new and old[0] == new[0]
            self._processes[name] = new
        self._processes = {n: one for n, one in self._processes.items() if n in self._seen}

    def _meet(self, master: Master, now: float) -> None:
        """Record a master; another process, or another run, is another master.

        It sets its /run_id shortly after its start: an empty one is not another run.
        """
        old = self._master
        self._master = master
        if old and old.pid == master.pid and (old.run == master.run or not old.run):
            return
        self._master_since = now
        self._restarts += bool(old)

    def samples(self) -> Iterator[Sample]:
        """Yield the metrics of the graph."""
        yield from (
            Sample("ros_exporter_dropped", count, {"what": what})
            for what, count in self._dropped.items()
        )
        yield from self._sample_master()
        for node in self._nodes():
            yield from self._sample_node(node)
        yield from self._sample_topics()

    def _sample_master(self) -> Iterator[Sample]:
        if self._graph.master:
            yield Sample("ros_master_up", self._graph.master.up)
            yield Sample("ros_master_restarts_total", self._restarts)
        if self._master:
            yield Sample("ros_master_start_time_seconds", self._master_since)

    def _nodes(self) -> list[Node]:
        """Return the nodes, and those that are missing but expected or seen before."""
        here = {node.name for node in self._graph.nodes}
        names = [*self._expected, *sorted(set(self._seen) - set(self._expected))]
        gone = [Node(name, up=False, registered=False) for name in names if name not in here]
        room = max(0, NODES - len(self._graph.nodes))
        return [*self._graph.nodes, *gone[: max(room, len(self._expected))]]

    def _sample_node(self, node: Node) -> Iterator[Sample]:
        labels = {"ros_node": node.name, "workload": self._workloads.get(node.name, "")}
        discovered = node.registered or node.name not in self._expected  # of another domain
        yield Sample("ros_node_up", node.up and discovered, labels)
        yield Sample("ros_node_registered", node.registered, labels)
        if self._graph.master:
            yield Sample("ros_node_missing_registrations", node.missing, labels)
        if node.name in self._processes:
            yield Sample("ros_node_restarts_total", self._restarted[node.name], labels)
        if node.stands is not None:
            yield Sample("ros_node_turn_age_seconds", node.stands, labels)

    def _sample_topics(self) -> Iterator[Sample]:
        for topic in self._graph.topics:
            labels = {"topic": topic.name, "type": topic.type}
            yield Sample("ros_topic_publishers", topic.publishers, labels)
            yield Sample("ros_topic_subscribers", topic.subscribers, labels)
        for part in self._graph.traffic:
            labels = {"ros_node": part.node, "topic": part.topic, "direction": part.direction}
            yield Sample("ros_node_topic_messages_total", part.messages, labels)
            if part.matched is None or part.size:
                yield Sample("ros_node_topic_bytes_total", part.size, labels)
            if part.matched is not None:
                yield Sample("ros_node_topic_partners", part.matched, labels)
                yield Sample("ros_node_topic_refused_total", part.refused, labels)
                yield Sample("ros_node_topic_dropped_total", part.dropped, labels)
            if part.silence is not None:
                yield Sample("ros_node_topic_longest_gap_seconds", part.gap, labels)
            if part.silence is not None and part.direction == "received":
                labels = {"ros_node": part.node, "topic": part.topic}
                yield Sample("ros_node_topic_age_seconds", part.age, labels)
        yield from self._sample_named()

    def _sample_named(self) -> Iterator[Sample]:
        """Yield what nodes counted on named topics: publishers, or else subscribers."""
        for topic in sorted(self._named):
            heard = [p for p in self._graph.traffic if p.topic == topic and p.matched is not None]
            sent = [part for part in heard if part.direction == "published"]
            silences = [part.silence for part in sent or heard if part.silence is not None]
            total = count_messages(heard)
            if total is not None:
                yield Sample("ros_topic_messages_total", total, {"topic": topic})
            if silences:
                last = self._now - min(silences)
                yield Sample("ros_topic_last_message_timestamp_seconds", last, {"topic": topic})


def _take_first(items: Iterable[T], most: int, key: Callable[[T], tuple[bool, str]]) -> list[T]:
    return sorted(items, key=key)[:most]


class Contract:
    """What is expected, and how it is by the latest look.

    Args:
        expected: fields of Expected, by topics' full names.
    """

    def __init__(self, expected: Mapping[str, Mapping[str, Any]]) -> None:
        self._expected = {topic: Expected(**fields) for topic, fields in expected.items()}
        self._looks: deque[tuple[float, Mapping[str, int]]] = deque()
        self._findings: list[tuple[str, Finding]] = []

    def take(self, graph: Graph, now: float) -> None:
        """Take in a look; `now` in seconds."""
        parts: dict[str, list[Traffic]] = {topic: [] for topic in self._expected}
        for part in graph.traffic:
            if part.topic in parts:
                parts[part.topic].append(part)
        counts = {topic: count_messages(its) for topic, its in parts.items()}
        while len(self._looks) > 1 and self._looks[1][0] <= now - WINDOW:
            self._looks.popleft()
        self._looks.append((now, {t: n for t, n in counts.items() if n is not None}))
        self._findings = []
        for topic, expected in self._expected.items():
            # Where its publishers were out of reach, what they sent meanwhile is no rate.
            seen = ((at, known[topic]) for at, known in self._looks if topic in known)
            (since, before), count = next(seen, (now, 0)), counts[topic]
            rate = None if count is None or now == since else (count - before) / (now - since)
            topics = [one for one in graph.topics if one.name == topic]
            reading = _read_topic(topics, parts[topic], rate)
            found = judge(expected, reading, now - since)
            self._findings += [(topic, finding) for finding in found]

    def samples(self) -> Iterator[Sample]:
        """Yield the metrics; what was not measured has none."""
        for topic, finding in self._findings:
            if finding.state != UNKNOWN:
                labels = {"topic": topic, "expectation": finding.what}
                yield Sample("ros_topic_as_expected", finding.state == OK, labels)


def _read_topic(topics: Sequence[Topic], traffic: Sequence[Traffic], rate: float | None) -> Reading:
    """Return what is known of a topic; it is several of `topics` if it has several types."""
    publishers = sum(one.publishers for one in topics)
    subscribers = sum(one.subscribers for one in topics)
    parts = [part for part in traffic if part.silence is not None]
    counted = subscribers or any(part.matched is not None for part in traffic)
    return Reading(
        type=", ".join(sorted({one.type for one in topics})) or None,
        # A publisher of ROS 1 without a subscriber counts nothing.
        rate=(rate if counted else None) if publishers else 0.0,
        gap=max((p.gap for p in parts if p.direction == "published"), default=None),
        age=max((p.age for p in parts if p.direction == "received"), default=None),
        publishers=publishers,
        subscribers=subscribers,
    )

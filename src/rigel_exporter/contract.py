"""Whether topics are as their application expects them, look by look."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rigel_exporter.expecting import OK, UNKNOWN, Expected, Finding, Reading, judge
from rigel_exporter.graph import Graph, Topic, Traffic, count_messages
from rigel_exporter.metrics import Sample

#: Seconds over which a rate is measured.
WINDOW = 30.0


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
            reading = _read(topics, parts[topic], rate)
            found = judge(expected, reading, now - since)
            self._findings += [(topic, finding) for finding in found]

    def samples(self) -> Iterator[Sample]:
        """Yield the metrics; what was not measured has none."""
        for topic, finding in self._findings:
            if finding.state != UNKNOWN:
                labels = {"topic": topic, "expectation": finding.what}
                yield Sample("ros_topic_as_expected", finding.state == OK, labels)


def _read(topics: Sequence[Topic], traffic: Sequence[Traffic], rate: float | None) -> Reading:
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

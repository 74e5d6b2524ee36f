"""Whether a ROS graph is as it is expected to be; pure.

Topics are judged by rigel_exporter.expecting.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import attrs

from rigel_exporter.expecting import ABSENT, BROKEN, UNKNOWN, Expected, Finding, Reading, judge
from rigel_graph.types import SPAN, GraphTopic, RosGraph

#: A rate is measured over so many messages of the lowest one, and so many seconds at most.
MESSAGES, LONGEST = 10, 10.0
#: What nodes elsewhere may add to.
COUNTS = ("publishers", "subscribers")


@attrs.frozen
class Verdict:
    """One thing that is expected of a topic, and how it is.

    Attributes:
        strict: an update that breaks it is rolled back.
    """

    topic: str
    finding: Finding
    strict: bool = False

    @property
    def broken(self) -> bool:
        """Whether it is known to be otherwise."""
        return self.finding.state == BROKEN

    @property
    def key(self) -> tuple[str, str]:
        """Differs for each thing that is expected."""
        return self.topic, self.finding.what

    def to_json(self) -> dict[str, Any]:
        return {"topic": self.topic, **self.finding._asdict()}

    @property
    def line(self) -> str:
        """What is broken, in one line."""
        what, _, expected, measured = self.finding
        if measured == ABSENT:
            return f"{self.topic}: {ABSENT}"
        return f"{self.topic}: {what} {measured}, expected {expected}"


def compare_with(expected: Mapping[str, Expected], graph: RosGraph) -> tuple[Verdict, ...]:
    """Return a verdict for each thing that is expected of topics, by their full names."""
    topics = {topic.name: topic for topic in graph.topics}
    return tuple(
        Verdict(name, finding, one.strict)
        for name, one in expected.items()
        for finding in judge(one, read_topic(topics.get(name)), graph.span)
    )


def compare_own(expected: Mapping[str, Expected], graph: RosGraph) -> tuple[Verdict, ...]:
    """Compare as compare_with a graph that the nodes in its pods alone have noted.

    What may be otherwise by nodes without a pod, which were discovered and not asked, is unknown.
    """
    verdicts = compare_with(expected, graph)
    if all(node.pod for node in graph.nodes):
        return verdicts
    own = {topic.name for topic in graph.topics if topic.publishers}
    return tuple(
        one
        if one.topic in own and one.finding.what not in COUNTS
        else attrs.evolve(one, finding=one.finding._replace(state=UNKNOWN))
        for one in verdicts
    )


def choose_span(expected: Mapping[str, Expected]) -> float:
    """Return for how many seconds to measure, so that one message more or less does not matter."""
    lowest = [one.rate[0] for one in expected.values() if one.rate and one.rate[0]]
    return max(SPAN, min(MESSAGES / min(lowest, default=MESSAGES), LONGEST))


def read_topic(topic: GraphTopic | None) -> Reading:
    """Return what is known of a topic; one that is not in the graph has no publisher."""
    if topic is None:
        return Reading(rate=0.0, publishers=0, subscribers=0)
    return Reading(
        type=topic.type or None,
        rate=topic.rate if topic.publishers else 0.0,
        gap=topic.gap,
        age=topic.age,
        publishers=len(topic.publishers),
        subscribers=len(topic.subscribers),
    )


def list_broken(before: Iterable[Verdict], after: Iterable[Verdict]) -> list[Verdict]:
    known = {one.key for one in before if one.broken}
    return [one for one in after if one.broken and one.key not in known]

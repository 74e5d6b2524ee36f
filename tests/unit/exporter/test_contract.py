"""When topics count as their application expects them, look by look."""

from __future__ import annotations

from typing import Any

from rigel_exporter.graph import Graph, Topic, Traffic
from rigel_exporter.standing import Contract

INF = float("inf")


def look(messages: int, *, publishers: int = 1, subscribers: int = 1, **more: Any) -> Graph:
    """Return a graph whose lidar has published so many messages on /scan, in ROS 2."""
    measured = {"matched": subscribers, "silence": 0.1, "gap": 0.2, **more}
    scan = Traffic("/lidar", "/scan", "published", messages, 0, **measured)
    return Graph(
        topics=[Topic("/scan", "sensor_msgs/msg/LaserScan", publishers, subscribers)],
        traffic=[scan] if publishers else [],
    )


def told(made: Contract) -> dict[str, bool]:
    return {sample.labels["expectation"]: bool(sample.value) for sample in made.samples()}


def test_a_rate_is_that_of_the_last_half_minute() -> None:
    """Not that of all time, in which a fall is lost; and not before there are two looks."""
    made = Contract({"/scan": {"rate": [8, 12]}})
    made.take(look(1000), 0.0)
    assert told(made) == {}
    for second in range(10, 310, 10):
        made.take(look(1000 + 10 * second), float(second))
        assert told(made) == {"rate": True}
    made.take(look(4000), 330.0)
    assert told(made) == {"rate": False}


def test_a_pod_that_was_out_of_reach_sends_no_burst() -> None:
    """All that it has sent since its start is not of the last seconds."""
    made = Contract({"/scan": {"rate": [8, 12]}})
    made.take(Graph(topics=[Topic("/scan", "a", 1, 1)]), 0.0)
    made.take(look(90_000), 10.0)
    assert told(made) == {}
    made.take(look(90_100), 20.0)
    assert told(made) == {"rate": True}


def test_a_topic_that_no_one_publishes_is_not_as_expected() -> None:
    made = Contract({"/scan": {"rate": [8, 12], "publishers": [1, 1]}, "/map": {"rate": [1, INF]}})
    made.take(look(0, publishers=0), 0.0)
    assert [(s.labels["topic"], s.value) for s in made.samples()] == [
        ("/scan", 0),
        ("/scan", 0),
        ("/map", 0),
    ]


def test_the_slowest_of_several_counts() -> None:
    made = Contract({"/scan": {"gap": 0.5, "age": 0.1, "subscribers": [1, INF]}})
    heard = [
        Traffic(node, "/scan", "received", 1, 0, matched=1, silence=0.1, gap=9.0, age=age)
        for node, age in (("/near", 0.01), ("/far", 0.2))
    ]
    graph = look(1)
    made.take(graph._replace(traffic=[*graph.traffic, *heard]), 0.0)
    assert told(made) == {"gap": True, "age": False, "subscribers": True}


def test_what_was_not_measured_has_no_series() -> None:
    """A publisher of ROS 1 counts nothing without a subscriber; a silent one has no gap yet."""
    made = Contract({"/scan": {"rate": [8, 12], "gap": 0.5, "age": 0.1, "publishers": [1, 1]}})
    for second in (0.0, 10.0):
        made.take(look(0, subscribers=0, matched=None, silence=None), second)
    assert told(made) == {"publishers": True}


def test_two_types_are_not_as_expected() -> None:
    """Whichever of them was expected."""
    made = Contract({"/scan": {"type": "sensor_msgs/LaserScan"}})
    made.take(look(1), 0.0)
    assert told(made) == {"type": True}
    graph = look(1)
    made.take(graph._replace(topics=[*graph.topics, Topic("/scan", "a/msg/B", 1, 0)]), 10.0)
    assert told(made) == {"type": False}

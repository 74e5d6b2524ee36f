"""How often a topic is published, once a second, by what its publishers count themselves.

Why not a subscription: it costs the network, and hears less than was sent if it is slow. ROS 2's
layer notes what passes, and ROS 1's nodes count the messages of each connection.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_exporter.notes import list_parts
from rigel_graph import ros1, ros2
from rigel_graph.discovery.losses import find_losses, measure_flows
from rigel_graph.pods import read_pods
from rigel_graph.types import GraphTopic
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId

EVERY = 1.0  # seconds between two readings
WINDOW = 10  # readings between which losses are looked for


class NoSource(Exception):
    """No publisher of the topic counts its messages."""


@attrs.frozen
class Beat:
    """A second of a topic; unknown values are None.

    Attributes:
        rate: messages per second.
        gap: the longest time between two messages, in seconds.
        subscribers: how many the publishers have.
        lost: messages per second that were sent and that subscribers have not taken.
    """

    rate: float
    gap: float | None = None
    subscribers: int | None = None
    lost: float | None = None


def measure(
    cluster: Cluster, release: ReleaseId, topic: GraphTopic, *, dds: bool
) -> Iterator[Beat]:
    """Yield a beat each second.

    Raises:
        NoSource: before the first one, if nothing counts.
        ClusterError: the pods cannot be read.
    """
    beats = beat_ros2(cluster, release, topic) if dds else beat_ros1(cluster, release, topic.name)
    due = time.monotonic()
    for beat in beats:
        if beat:
            yield beat
        due = max(due + EVERY, time.monotonic())
        time.sleep(due - time.monotonic() if due > time.monotonic() else 0)


def beat_ros2(cluster: Cluster, release: ReleaseId, topic: GraphTopic) -> Iterator[Beat | None]:
    """Yield a beat at each call, first None."""
    readings: deque[dict[str, Mapping[str, Any]]] = deque(maxlen=WINDOW)
    while True:
        answers, _ = ros2.ask_all(cluster, read_pods(list_pods(cluster, release)), 0.0)
        readings.append({pod: answer["second"] for pod, answer in answers.items()})
        if len(readings) == 1:
            parts = list_parts(readings[0])
            if not any(one.kind == "publisher" and one.name == topic.name for one in parts):
                raise NoSource
            yield None
        else:
            yield read_beat(readings, topic.name)


def read_beat(readings: deque[dict[str, Mapping[str, Any]]], topic: str) -> Beat:
    """Return the beat of the last reading: what pods have noted, by their keys; pure."""
    before, now = readings[-2], readings[-1]
    pairs = {key: {"first": before.get(key, now[key]), "second": now[key]} for key in now}
    parts = [one for one in list_parts(now) if one.name == topic]
    senders = [one for one in parts if one.kind == "publisher"]
    pairs = {key: one for key, one in pairs.items() if one["first"] is not one["second"]}
    flows = [
        flow
        for key in pairs
        for flow in measure_flows(next(one[key] for one in readings if key in one), now[key])
        if flow.topic == topic
    ]
    lost = sum(loss.sent - loss.taken for loss in find_losses(flows))
    return Beat(
        ros2.measure_rates(pairs)[topic],
        max((one.gap for one in senders), default=None),
        max((one.matched for one in senders), default=0),
        lost if any(not flow.sent for flow in flows) else None,
    )


def beat_ros1(cluster: Cluster, release: ReleaseId, topic: str) -> Iterator[Beat | None]:
    """Yield a beat at each call, first None."""
    before: dict[str, Mapping[str, Any]] = {}
    counted = False
    while True:
        answer = ros1.ask(cluster, read_pods(list_pods(cluster, release)), 0.0)
        now = {one["name"]: one for one in answer["nodes"]}
        if before:
            rate = ros1.measure_rates(pair(before, now)).get(topic)
            if rate is None and not counted:
                raise NoSource
            counted = True
            hearers = ros1.list_others(answer["subscribers"].get(topic, ()))
            yield Beat(rate or 0.0, subscribers=len(hearers))
        else:
            yield None
        before = now


def pair(
    before: Mapping[str, Mapping[str, Any]], now: Mapping[str, Mapping[str, Any]]
) -> Iterator[Mapping[str, Any]]:
    """Yield nodes with the counters of two readings, as of one that read them twice; pure."""
    for name, one in now.items():
        old = before.get(name, {})
        if "stats" in one and "stats" in old and old["uri"] == one["uri"]:
            seconds = one["at"] - old["at"]
            yield {**one, "stats": [*old["stats"], *one["stats"]], "seconds": seconds}

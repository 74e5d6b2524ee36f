"""The named topics, and /diagnostics, /clock and /tf: received best effort, exported with limits.

It decides which topics to subscribe to and what their messages mean; the halves receive them. Times
are seconds since 1970, or ROS times where noted.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

from rigel_exporter import messages
from rigel_exporter.config import Config
from rigel_exporter.graph import Half
from rigel_exporter.metrics import Sample
from rigel_exporter.samples import Samples, Subscription

#: How many statuses and transforms are exported at most.
STATUSES, TRANSFORMS = 200, 200
#: Seconds after which a status that is not repeated is stale, and after which it is forgotten.
STALE, FORGOTTEN = 30.0, 3600.0
_DIAGNOSTICS, _CLOCK, _TF = "/diagnostics", "/clock", "/tf"
#: How many of a topic's latest messages are kept between two readings, a second apart.
_KEPT = {_DIAGNOSTICS: 200, _CLOCK: 1, _TF: 500}
_STALE_LEVEL = 3


class Listening:
    """The subscribers of one exporter."""

    def __init__(self, half: Half, config: Config) -> None:
        """Subscribe to the topics of the configuration, and to nothing else."""
        self._half = half
        self._named = frozenset(() if half.counts else config.topics)
        readers: dict[str, tuple[bool, Callable[[bytes, float], None]]] = {
            _DIAGNOSTICS: (config.diagnostics, self._statuses),
            _CLOCK: (config.clock, self._time),
            _TF: (config.tf, self._take_transforms),
        }
        self._read = {topic: read for topic, (asked, read) in readers.items() if asked}
        wanted = dict.fromkeys([*sorted(self._named), *self._read])
        self._subscribers: dict[str, Subscription] = {
            topic: half.subscribe(topic, keep=_KEPT[topic] if topic in self._read else 0)
            for topic in wanted
        }
        self._lock = threading.Lock()
        self._heard: dict[str, Samples] = {}
        self._levels: dict[tuple[str, str], tuple[int, float]] = {}
        self._frames: dict[tuple[str, str], tuple[float, float]] = {}
        self._clock: float | None = None
        self._over: dict[str, set[Any]] = {"diagnostics": set(), "transforms": set()}
        self._unreadable = 0

    @property
    def unreadable(self) -> int:
        """How many messages did not have the type that their topic's name requires."""
        return self._unreadable

    def refresh(self, now: float) -> None:
        """Take in what has arrived."""
        with self._lock:
            for topic, subscriber in self._subscribers.items():
                samples = self._heard[topic] = subscriber.samples()
                for payload in samples.payloads:
                    self._take(topic, payload, now)
            for kept in (self._levels, self._frames):
                for key in [k for k, (_, when) in kept.items() if when + FORGOTTEN < now]:
                    del kept[key]

    def _take(self, topic: str, payload: bytes, now: float) -> None:
        try:
            self._read[topic](payload, now)
        except ValueError:
            self._unreadable += 1

    def _statuses(self, payload: bytes, now: float) -> None:
        for name, hardware, level in messages.diagnostics(self._half.read(payload)):
            if self._room("diagnostics", self._levels, (name, hardware), STATUSES):
                self._levels[name, hardware] = level, now

    def _time(self, payload: bytes, _: float) -> None:
        self._clock = self._half.read(payload).time()

    def _take_transforms(self, payload: bytes, now: float) -> None:
        for parent, child, stamp in messages.transforms(self._half.read(payload)):
            if self._room("transforms", self._frames, (parent, child), TRANSFORMS):
                self._frames[parent, child] = stamp, now

    def _room(self, what: str, kept: dict[Any, Any], key: Any, most: int) -> bool:
        if key in kept or len(kept) < most:
            return True
        if len(self._over[what]) < most:  # enough to count what is above the limit
            self._over[what].add(key)
        return False

    def samples(self, now: float) -> Iterator[Sample]:
        """Yield the metrics."""
        self.refresh(now)
        with self._lock:
            yield from self._sample_topics()
            yield from self._sample_diagnostics(now)
            yield from self._sample_time(now)
        for what, keys in self._over.items():
            if keys:
                yield Sample("ros_exporter_dropped", len(keys), {"what": what})

    def _sample_topics(self) -> Iterator[Sample]:
        for topic in sorted(self._named):
            heard, labels = self._heard[topic], {"topic": topic}
            yield Sample("ros_topic_messages_total", heard.messages, labels)
            yield Sample("ros_topic_bytes_total", heard.size, labels)
            if heard.last is not None:
                yield Sample("ros_topic_last_message_timestamp_seconds", heard.last, labels)
                if heard.stamp is not None:
                    age = heard.last - heard.stamp
                    yield Sample("ros_topic_header_age_seconds", age, labels)

    def _sample_diagnostics(self, now: float) -> Iterator[Sample]:
        for (name, hardware), (level, when) in sorted(self._levels.items()):
            shown = _STALE_LEVEL if when + STALE < now else level
            labels = {"name": name, "hardware_id": hardware}
            yield Sample("ros_diagnostics_level", shown, labels)

    def _sample_time(self, now: float) -> Iterator[Sample]:
        clock = self._heard.get(_CLOCK)
        if _CLOCK in self._read and clock and clock.last is not None:
            yield Sample("ros_clock_age_seconds", now - clock.last)
        ros_now = now if self._clock is None else self._clock
        for (parent, child), (stamp, _) in sorted(self._frames.items()):
            labels = {"parent": parent, "child": child}
            yield Sample("ros_tf_age_seconds", ros_now - stamp, labels)

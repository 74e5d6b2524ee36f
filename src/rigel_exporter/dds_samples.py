"""A named topic: its writers' samples are counted when they arrive, and forgotten.

Why: rate, bandwidth and age of a topic can only be measured by subscribing to it. A sample counts
with the first of its fragments, which contains its size, so a lost fragment only loses that
sample's payload. It must not depend on sockets, or on how readers are announced.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Lock

from rigel_exporter import dds_messages as messages
from rigel_exporter import dds_wire as wire
from rigel_exporter.dds_reliable import Assembly
from rigel_exporter.graph import Samples


class Source:
    """One writer of a named topic, and what was received from it."""

    def __init__(self, hearing: Hearing, type_name: str) -> None:
        self.hearing, self.type = hearing, type_name
        self._last = 0
        self._whole: Assembly | None = None

    def take(self, item: wire.Data | wire.Fragment, now: float) -> None:
        """Take in a sample or fragments of one; `now` is in seconds since 1970."""
        if isinstance(item, wire.Data):
            if item.number > self._last and len(item.payload):
                self._last = item.number
                self.hearing.count(len(item.payload), self._stamp(item.payload), now)
                self.hearing.keep(item.payload)
        elif item.number >= self._last:
            self._take_part(item, now)

    def _take_part(self, part: wire.Fragment, now: float) -> None:
        if part.number > self._last:
            self._last, self._whole = part.number, None
            self.hearing.count(part.total, None, now)
            if self.hearing.keeps and Assembly.fits(part):
                self._whole = Assembly(part)
        if part.first == 1:
            self.hearing.stamp(self._stamp(part.payload))
        whole = self._whole.add(part) if self._whole else None
        if whole is not None:
            self._whole = None
            self.hearing.keep(memoryview(whole))

    def _stamp(self, payload: memoryview) -> float | None:
        try:
            return messages.stamp(payload, self.type)
        except messages.Unreadable:
            return None


class Hearing:
    """What was received of one named topic; a graph.Subscriber."""

    def __init__(self, topic: str, keep: int, leave: Callable[[Hearing], None]) -> None:
        self.topic, self.keeps = topic, keep
        self._leave = leave
        self._lock = Lock()
        self._messages, self._size = 0, 0
        self._last: float | None = None
        self._stamp: float | None = None
        self._payloads: deque[bytes] = deque(maxlen=keep)

    def samples(self) -> Samples:
        """Return the counts up to now; kept payloads are handed out once."""
        with self._lock:
            found = tuple(self._payloads)
            self._payloads.clear()
            return Samples(self._messages, self._size, self._last, self._stamp, found)

    def close(self) -> None:
        """Remove the readers from all participants."""
        self._leave(self)

    def count(self, size: int, stamp: float | None, now: float) -> None:
        """Count a sample whose first fragment has arrived."""
        with self._lock:
            self._messages += 1
            self._size += size
            self._last, self._stamp = now, stamp or self._stamp

    def stamp(self, stamp: float | None) -> None:
        """Record the header's stamp of the sample that was counted last."""
        with self._lock:
            self._stamp = stamp or self._stamp

    def keep(self, payload: memoryview) -> None:
        """Keep a complete payload, if payloads are kept."""
        if self.keeps:
            with self._lock:
                self._payloads.append(bytes(payload))

"""What a named topic's subscriber has received: counted when it arrives, and forgotten.

Rate, bandwidth and age of a topic can only be measured by subscribing to it. The halves receive.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from threading import Lock
from typing import NamedTuple

from rigel_exporter.messages import Payload


class Samples(NamedTuple):
    """What a subscriber has received since it began.

    Attributes:
        messages: how many, across reconnects.
        size: the bytes of their payloads.
        last: when the latest arrived, in seconds since 1970; None for never.
        stamp: the latest header's stamp in seconds (ROS time); None if there is no header.
        payloads: the latest messages in their serialized form, oldest first, if they are kept.
    """

    messages: int = 0
    size: int = 0
    last: float | None = None
    stamp: float | None = None
    payloads: Sequence[bytes] = ()


class Subscription:
    """One named topic, received best effort; it continues after restarts of publishers."""

    def __init__(self, topic: str, keep: int, leave: Callable[[Subscription], None]) -> None:
        """Keep that many of the latest payloads; `leave` is called when it is closed."""
        self.topic, self.keeps = topic, keep > 0
        self._leave = leave
        self._lock = Lock()
        self._now = Samples()
        self._payloads: deque[bytes] = deque(maxlen=keep)

    def samples(self) -> Samples:
        """Return the counts up to now; kept payloads are handed out once."""
        with self._lock:
            found = self._now._replace(payloads=tuple(self._payloads))
            self._payloads.clear()
            return found

    def close(self) -> None:
        """Leave the graph, and announce that."""
        self._leave(self)

    def count(self, size: int, stamp: float | None, now: float) -> None:
        """Count a message that has arrived, or the first fragment of one."""
        with self._lock:
            messages, total, _, before, _ = self._now
            self._now = Samples(messages + 1, total + size, now, stamp or before)

    def stamp(self, stamp: float | None) -> None:
        """Record the header's stamp of the message that was counted last."""
        with self._lock:
            self._now = self._now._replace(stamp=stamp or self._now.stamp)

    def keep(self, payload: Payload) -> None:
        """Keep a complete payload, if payloads are kept."""
        if self.keeps:
            with self._lock:
                self._payloads.append(bytes(payload))

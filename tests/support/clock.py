"""Clocks in place of the module `time` of what is tested: no machine is too slow for them."""

from __future__ import annotations

import threading
from collections.abc import Callable

import attrs


@attrs.define
class Clock:
    """A clock that is moved by hand."""

    now: float = 0.0

    def monotonic(self) -> float:
        return self.now


@attrs.define
class Leap:
    """A clock that stands still until something has happened, and then leaps, once.

    Attributes:
        happened: whether it has; it is asked at each look at the clock.
        seconds: how far it leaps.
    """

    happened: Callable[[], object]
    seconds: float
    now: float = 1000.0

    def monotonic(self) -> float:
        self.now += 1e-6  # what comes later is later
        if self.seconds and self.happened():
            self.now, self.seconds = self.now + self.seconds, 0.0
        return self.now


class Waits(threading.Event):
    """What ends a wait, and moves a clock by the time of each wait instead of waiting."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        self.clock.now += timeout or 0.0
        return self.is_set()

"""Clocks in place of the module `time` of what is tested: no machine is too slow for them."""

from __future__ import annotations

import threading
from collections.abc import Callable

import attrs
import pytest

from rigel_k8s.release.rollout import wait

from .recorder import Recorder


@attrs.define
class Clock:
    """A clock that is moved by hand."""

    now: float = 0.0

    def monotonic(self) -> float:
        return self.now


@attrs.define
class Leap:
    """A clock that stands still until something has happened, and then leaps, once.

    It leaps at the second look that finds it: the first one may be the start of a time that counts.

    Attributes:
        happened: whether it has; it is asked at each look at the clock.
        seconds: how far it leaps.
    """

    happened: Callable[[], object]
    seconds: float
    now: float = 1000.0
    found: bool = False

    def monotonic(self) -> float:
        self.now += 1e-6  # what comes later is later
        if self.found:
            self.now, self.seconds = self.now + self.seconds, 0.0
        self.found = bool(self.happened())
        return self.now


def leap_when_shown(
    monkeypatch: pytest.MonkeyPatch, report: Recorder, seconds: float, *states: tuple[str, str]
) -> None:
    """Let a roll-out's clock stand still until all these states are shown: (workload, words).

    What an earlier roll-out has shown does not count: the clock would leap before this one waits.
    """
    earlier = len(report.states)

    def is_shown(name: str, words: str) -> bool:
        return any(key == name and words in text for key, text, _ in report.states[earlier:])

    clock = Leap(lambda: all(is_shown(*state) for state in states), seconds)
    monkeypatch.setattr(wait, "time", clock)


class Waits(threading.Event):
    """What ends a wait, and moves a clock by the time of each wait instead of waiting."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self.clock = clock

    def wait(self, timeout: float | None = None) -> bool:
        self.clock.now += timeout or 0.0
        return self.is_set()

"""Whether a topic is as its application expects it: `judge`; pure.

Why: all who compare a graph with what is expected of it agree by this. What was not measured is
unknown, never broken: whoever watches may be what is broken.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

OK, BROKEN, UNKNOWN = "ok", "broken", "unknown"
ABSENT = "no publisher"
TIMES = ("gap", "age")

_Range = tuple[float, float]


class Expected(NamedTuple):
    """What is expected of a topic; None where nothing is.

    Attributes:
        type: as in sensor_msgs/msg/LaserScan; ROS 1 leaves `msg` out, and so may everyone.
        rate: messages per second; this, `publishers` and `subscribers` are (lowest, highest), both
            allowed.
        gap: the longest time between two messages of a publisher, in seconds.
        age: from the publication of a message to its taking, at most, in seconds.
        strict: an update that breaks it is rolled back.
    """

    type: str | None = None
    rate: _Range | None = None
    gap: float | None = None
    age: float | None = None
    publishers: _Range | None = None
    subscribers: _Range | None = None
    strict: bool = False


class Reading(NamedTuple):
    """What was measured of a topic, in the units of Expected; None where nothing was.

    Attributes:
        gap: of the last minute, or since the last message, of the slowest publisher.
        age: of the last message, of the slowest subscriber.
    """

    type: str | None = None
    rate: float | None = None
    gap: float | None = None
    age: float | None = None
    publishers: int | None = None
    subscribers: int | None = None


class Finding(NamedTuple):
    """How one thing is.

    Attributes:
        what: a field of Reading.
        state: ok, broken or unknown.
        expected, measured: for people.
    """

    what: str
    state: str
    expected: str
    measured: str


def judge(expected: Expected, reading: Reading, span: float = 0.0) -> Iterator[Finding]:
    """Yield how each thing is that is expected.

    Args:
        span: seconds over which the rate was measured. One message more or less may have been in
            it, so a rate that close to a limit is not broken. 0: the rate is exact.
    """
    slack = 1 / span if span and reading.publishers else 0.0
    for what, measured in reading._asdict().items():
        wanted = getattr(expected, what)
        if wanted is not None:
            given = (wanted, measured, reading.publishers, slack if what == "rate" else 0.0)
            yield Finding(what, *_judge_one(what, *given))


def _judge_one(
    what: str, wanted: Any, measured: Any, publishers: int | None, slack: float
) -> tuple[str, str, str]:
    text = describe(what, wanted)
    if measured is None:
        return (BROKEN, text, ABSENT) if publishers == 0 else (UNKNOWN, text, "not measured")
    if what == "type":
        good, shown = _plain(measured) == _plain(wanted), measured
    elif what in TIMES:
        good, shown = measured <= wanted, describe(what, measured)
    else:
        good = wanted[0] - slack <= measured <= wanted[1] + slack
        shown = describe(what, (measured, measured))
    return OK if good else BROKEN, text, shown


def _plain(kind: str) -> str:
    """Return a type as ROS 1 writes it."""
    return kind.replace("/msg/", "/")


def describe(what: str, value: Any) -> str:
    """Return what is expected, or was measured, as a text."""
    if what == "type":
        return str(value)
    if what in TIMES:
        return f"{_number(value)} s" if value >= 1 else f"{1000 * value:.3g} ms"
    unit = "/s" if what == "rate" else ""
    low, high = value
    if low == high:
        return _number(low) + unit
    if high == float("inf"):
        return f"{_number(low)}{unit} or more"
    return f"{_number(low)}..{_number(high)}{unit}"


def _number(value: float) -> str:
    return f"{value:.0f}" if value == int(value) or value >= 100 else f"{value:.3g}"

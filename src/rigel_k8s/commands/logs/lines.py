"""Log lines as plain data, with the times at which the container runtime recorded them."""

from __future__ import annotations

import heapq
import re
from collections.abc import Iterable, Iterator
from datetime import datetime, timezone

import attrs

from rigel_k8s.observability import lines
from rigel_k8s.observability.names import LEVELS

SECOND = 1_000_000_000
#: How much later than a line one with an earlier time may be recorded.
DISORDER = 2 * SECOND
STAMP = re.compile(
    r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?(Z|[+-]\d\d:\d\d) ?(.*)", re.DOTALL
)


@attrs.frozen
class LogLine:
    """One line, and what it is of.

    Attributes:
        text: without its line end.
        note: the line is ours, not the pod's.
        time: nanoseconds since 1970, None if it is unknown.
        level: one of names.LEVELS, "" if unknown.
        ros_node: the ROS name, "" if the pod is not of a ROS node.
        node: the machine.
    """

    workload: str
    pod: str
    text: str
    note: bool = False
    time: int | None = None
    level: str = ""
    ros_node: str = ""
    node: str = ""


def split_stamp(line: str) -> tuple[int | None, str]:
    """Return the time before a line, in nanoseconds since 1970, and the line without it."""
    found = STAMP.fullmatch(line)
    if not found:
        return None, line
    day, fraction, zone, text = found.groups()
    offset = "+00:00" if zone == "Z" else zone
    seconds = int(datetime.fromisoformat(day + offset).timestamp())
    return seconds * SECOND + int((fraction or "0").ljust(9, "0")), text


def stamp(time: int) -> str:
    """Return a time in the form of Kubernetes: 2026-11-21T12:00:00.000000001Z."""
    seconds, rest = divmod(time, SECOND)
    day = datetime.fromtimestamp(seconds, timezone.utc)
    return f"{day:%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"


def sort_lines(lines: Iterable[LogLine]) -> Iterator[LogLine]:
    """Yield one container's lines by time: its two outputs are recorded separately.

    On a busy machine one of them may be later by a tenth of a second.
    """
    held: list[tuple[int, int, LogLine]] = []
    for number, line in enumerate(lines):
        if line.time is None:
            yield line
            continue
        heapq.heappush(held, (line.time, number, line))
        while held[0][0] < line.time - DISORDER:
            yield heapq.heappop(held)[2]
    yield from (line for _, _, line in sorted(held))


def time_of(line: LogLine) -> int:
    """Return a line's time; lines without one come first."""
    return line.time or 0


@attrs.frozen
class LogOptions:
    """Which log lines: of the last seconds, the last N, of the previous container.

    Attributes:
        level: one of names.LEVELS, and all above it.
    """

    follow: bool = False
    since: int | None = None
    tail: int | None = None
    previous: bool = False
    level: str | None = None

    @property
    def of_the_past(self) -> bool:
        """Whether it requests more than the existing containers have."""
        return (self.since is not None or self.level is not None) and not self.previous


FORMS = tuple(re.compile(form) for form in lines.LEVEL_FORMS)
GOES_ON = re.compile(lines.GOES_ON)
TRACEBACK = re.compile(lines.TRACEBACK)
HEAD = "Traceback (most recent call last):"
#: Other words for a level.
SAME = {"warning": "warn", "critical": "fatal", "trace": "debug"}


def level_of(line: str) -> str:
    """Return the level in a line: one of LEVELS, or "" if it has none."""
    for form in FORMS:
        if found := form.match(line):
            word = found["level"].lower()
            return SAME.get(word, word)
    return "error" if TRACEBACK.match(line) else ""


def at_least(level: str) -> frozenset[str]:
    """Return a level and those above it."""
    return frozenset(LEVELS[LEVELS.index(level) :])


class LevelReader:
    """Gives each line of one container its level: continuation lines have that of the first line.

    Continuation lines are blank and indented lines, and everything after a Python traceback's head
    up to its exception, with the exceptions that it was raised from. A traceback that does not
    follow a log line is an error, whatever was logged before it.
    """

    def __init__(self) -> None:
        self._level = ""
        self._open = False  # within a traceback, before its exception

    def level(self, line: str) -> str:
        """Return the next line's level."""
        indented = not line.strip() or line[:1].isspace()
        own = level_of(line)
        if own or not (indented or self._open or GOES_ON.match(line)):
            self._level = own
        self._open = HEAD in line or (self._open and indented)
        return self._level

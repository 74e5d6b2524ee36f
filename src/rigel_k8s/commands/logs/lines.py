"""Log lines as plain data: their times, and how to merge two sources of the same lines.

Loki and the API server have the same time for the same line, to the nanosecond: the one that the
container runtime recorded.
"""

from __future__ import annotations

import heapq
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from datetime import datetime, timezone

import attrs

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
        text: without its line end; without `time`, it may begin with the time stamp.
        note: the line is ours, not the pod's.
        time: nanoseconds since 1970, None if it was not requested.
        level: one of names.LEVELS, "" if unknown.
        ros_node: the ROS name, "" if the pod is not of a ROS node.
        node: the machine.
        part: which line of an entry of several (a traceback) it is; all have the entry's time.
    """

    workload: str
    pod: str
    text: str
    note: bool = False
    time: int | None = None
    level: str = ""
    ros_node: str = ""
    node: str = ""
    part: int = 0


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


def merge_lines(stored: Iterable[LogLine], fresh: Iterable[LogLine]) -> Iterator[LogLine]:
    """Yield the lines of both by time, common lines once; each of them is already sorted.

    A fresh line of a traceback has its own time, a stored one the time of its entry.
    """
    both = Both()
    sources = (((time_of(line), 0, line) for line in stored),) + (
        ((time_of(line), 1, line) for line in fresh),
    )
    for _, source, line in heapq.merge(*sources, key=lambda item: item[:2]):
        if source == 0:
            both.store(line)
        elif both.has(line):
            continue
        yield line


class Both:
    """Finds lines that are in both sources; they come by time, the stored ones first."""

    def __init__(self) -> None:
        self._time = -1
        self._first: dict[tuple[str, str], list[str]] = {}  # of entries of this moment: the rest
        self._rest: Counter[tuple[str, str]] = Counter()  # of entries that are in both

    def store(self, line: LogLine) -> None:
        """Take a stored line."""
        if time_of(line) > self._time:
            self._time = time_of(line)
            self._first.clear()
        if line.part == 0:
            self._first[line.pod, line.text] = []
        elif self._first:
            self._first[next(reversed(self._first))].append(line.text)

    def has(self, line: LogLine) -> bool:
        """Return whether a fresh line is stored too."""
        key = (line.pod, line.text)
        if time_of(line) == self._time and key in self._first:
            self._rest.update((line.pod, text) for text in self._first.pop(key))
            return True
        if self._rest[key] > 0:
            self._rest[key] -= 1
            return True
        return False


def time_of(line: LogLine) -> int:
    """Return a line's time; lines without one come first."""
    return line.time or 0


@attrs.frozen
class LogOptions:
    """Which log lines: of the last seconds, the last N, of the previous container.

    Attributes:
        level: one of names.LEVELS, and all above it.
        parsed: with time and level of each line, in the order of time.
    """

    follow: bool = False
    since: int | None = None
    tail: int | None = None
    previous: bool = False
    timestamps: bool = False
    level: str | None = None
    parsed: bool = False

    @property
    def of_the_past(self) -> bool:
        """Whether it requests more than the existing containers have."""
        return (self.since is not None or self.level is not None) and not self.previous

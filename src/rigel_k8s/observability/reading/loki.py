"""Loki's API: the streams and their lines by time; independent of pods and releases."""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import attrs

#: Requests a path with a query, and returns the answer's body.
Ask = Callable[[str, Mapping[str, object]], bytes]

DAY = 24 * 3600 * 1_000_000_000
LONGEST = 30 * DAY  # Loki's own limit for the range of one query
PAGE = 5000  # Loki's own limit for the entries of one answer


@attrs.frozen
class Entry:
    """A log entry: nanoseconds since 1970, its stream's labels, its text of one or more lines."""

    time: int
    labels: Mapping[str, str]
    text: str


def selector(**labels: Collection[str] | str) -> str:
    """Return LogQL's selector of streams: each label is this value, or one of these."""
    matchers = ", ".join(matcher(name, value) for name, value in labels.items() if value)
    return f"{{{matchers}}}"


def matcher(label: str, value: Collection[str] | str) -> str:
    if isinstance(value, str):
        return f"{label}={json.dumps(value)}"
    return f"{label}=~{json.dumps('|'.join(map(re.escape, sorted(value))))}"


class LokiClient:
    """Reads what a Loki has stored; times are nanoseconds since 1970, `end` is not included."""

    def __init__(self, ask: Ask) -> None:
        self._ask = ask

    def series(self, query: str, start: int, end: int) -> list[dict[str, str]]:
        """Return the labels of all streams that a selector finds."""
        found: dict[str, dict[str, str]] = {}
        for begin, until in windows(start, end):
            words = {"match[]": query, "start": str(begin), "end": str(until)}
            for labels in self._data("series", words):
                found[json.dumps(labels, sort_keys=True)] = labels
        return list(found.values())

    def entries(self, query: str, start: int, end: int) -> Iterator[Entry]:
        """Yield all entries, the oldest first."""
        for begin, until in windows(start, end):
            yield from self._pages(query, begin, until)

    def read_last(self, query: str, start: int, end: int, count: int) -> list[Entry]:
        """Return the last `count` entries, the oldest of them first."""
        if count > PAGE:
            return list(deque(self.entries(query, start, end), maxlen=count))
        found: list[Entry] = []
        for begin, until in reversed(windows(start, end)):
            limit = min(PAGE, count - len(found))
            if limit > 0:
                found = [*self._range(query, begin, until, "backward", limit), *found]
        return found

    def _pages(self, query: str, begin: int, until: int) -> Iterator[Entry]:
        """Yield a window's entries; a page begins at the time at which the one before ended."""
        known: list[Entry] = []
        while True:
            page = self._range(query, begin, until, "forward", PAGE)
            yield from (entry for entry in page if entry not in known)
            if len(page) < PAGE:
                return
            latest = page[-1].time
            if latest == begin:  # more entries with the same time than an answer may contain
                known, begin = [], latest + 1
            else:
                known, begin = [entry for entry in page if entry.time == latest], latest

    def _range(self, query: str, begin: int, until: int, direction: str, limit: int) -> list[Entry]:
        """Return one answer's entries by time."""
        words = {
            "query": query,
            "start": str(begin),
            "end": str(until),
            "direction": direction,
            "limit": str(limit),
        }
        streams = self._data("query_range", words)["result"]
        found = [
            Entry(int(value[0]), stream["stream"], value[1])
            for stream in streams
            for value in sorted(stream["values"], key=lambda value: int(value[0]))
        ]
        return sorted(found, key=lambda entry: entry.time)

    def _data(self, what: str, words: Mapping[str, object]) -> Any:
        return json.loads(self._ask(f"loki/api/v1/{what}", words)).get("data") or []


def windows(start: int, end: int) -> list[tuple[int, int]]:
    """Return a range in parts that Loki accepts."""
    return [(begin, min(begin + LONGEST, end)) for begin in range(start, end, LONGEST)]

"""What ROS 1 nodes count for each connection, added up to counters that never decrease.

A node drops a connection's numbers when it ends, and roscpp's are 32 bits wide.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from rigel_exporter.graph import Traffic

_Key = tuple[str, str, str]
_WIDTH = 1 << 32


def count_growth(old: int, new: int) -> int:
    """Return how much a connection's counter has grown, past an overflow or a restart."""
    if new >= old:
        return new - old
    return (new - old) % _WIDTH if new < 0 <= old else max(new, 0)


class Ledger:
    """The totals of all nodes, by node, topic and direction."""

    def __init__(self) -> None:
        self._seen: dict[_Key, dict[tuple[str, str], tuple[int, int]]] = {}
        self._totals: dict[_Key, list[int]] = defaultdict(lambda: [0, 0])

    def add(self, node: str, uri: str, stats: Any) -> None:
        """Take in what a node answered to getBusStats.

        A message to several subscribers was published once: the connection with most messages
        counts. Its bytes were sent for each.
        """
        for direction, topic, connections in _entries(stats):
            key = (node, topic, direction)
            seen = self._seen.get(key, {})
            now = {(uri, c): counts for c, *counts in connections}
            steps = [
                [count_growth(a, b) for a, b in zip(seen.get(c, (0, 0)), counts)]
                for c, counts in now.items()
            ]
            self._seen[key] = {c: (counts[0], counts[1]) for c, counts in now.items()}
            messages = [step[0] for step in steps]
            total = self._totals[key]
            total[0] += max(messages, default=0) if direction == "published" else sum(messages)
            total[1] += sum(step[1] for step in steps)

    def keep(self, nodes: Iterable[str]) -> None:
        """Forget all nodes but these."""
        wanted = set(nodes)
        for key in [key for key in self._totals if key[0] not in wanted]:
            self._totals.pop(key)
            self._seen.pop(key, None)

    def totals(self) -> list[Traffic]:
        """Return all totals."""
        return [Traffic(*key, *total) for key, total in sorted(self._totals.items())]


def _entries(stats: Any) -> Iterator[tuple[str, str, list[tuple[str, int, int]]]]:
    """Yield (direction, topic, connections), a connection being (id, messages, bytes).

    rospy and roscpp disagree about what a publisher's entry has, and where.
    """
    published, received = (*stats, [], [])[:2] if isinstance(stats, list) else ([], [])
    for topic, *rest in published:
        yield "published", topic, [_parse_connection(c) for c in _connections(rest) if len(c) >= 4]
    for topic, *rest in received:
        yield "received", topic, [(c[0], int(c[2]), int(c[1])) for c in _connections(rest)]


def _connections(rest: Sequence[Any]) -> list[list[str]]:
    return [c for part in rest if isinstance(part, list) for c in part if len(c) >= 3]


def _parse_connection(entry: Sequence[str]) -> tuple[str, int, int]:
    """Return a connection; roscpp's has one more number, the bytes with the messages' lengths."""
    if len(entry) >= 5:
        return entry[0], int(entry[3]), int(entry[2])
    return entry[0], int(entry[2]), int(entry[1])

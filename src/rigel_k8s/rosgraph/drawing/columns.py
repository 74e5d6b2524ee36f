"""Gives each vertex of a directed graph a column, so that edges lead from left to right.

Edges that close a cycle are reversed, and each vertex gets a column behind those that point to it.
The same input gives the same result.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

import attrs

TURNED = 3  # a reversed edge counts as one across so many more columns


@attrs.frozen
class Shape:
    """A vertex: its size, its group's index, and whether it is in an even or an odd column."""

    width: float
    height: float
    group: int
    odd: bool = False


def turn(edges: Sequence[tuple[str, str]], turned: Sequence[bool]) -> list[tuple[str, str]]:
    """Return edges, some of them reversed."""
    return [(v, u) if back else (u, v) for (u, v), back in zip(edges, turned, strict=True)]


def choose_turned(shapes: Mapping[str, Shape], edges: Sequence[tuple[str, str]]) -> list[bool]:
    """Return which edges are reversed so that no cycle is left: the better of two ways.

    One reverses few edges; the other begins where a vertex of the even columns has few inputs, such
    as a driver that only receives commands. The fewer columns edges cross, the better.
    """
    ways = [
        find_turned(shapes, edges, lambda name, out, into: (out - into, 0)),
        find_turned(shapes, edges, lambda name, out, into: (-into - 99 * shapes[name].odd, out)),
    ]

    def cost(turned: Sequence[bool]) -> int:
        forward = turn(edges, turned)
        columns = choose_columns(shapes, forward)
        return sum(columns[v] - columns[u] for u, v in forward) + TURNED * sum(turned)

    return min(ways, key=cost)


def find_turned(
    names: Iterable[str],
    edges: Sequence[tuple[str, str]],
    worth: Callable[[str, int, int], tuple[int, int]],
) -> list[bool]:
    """Return which edges are reversed so that no cycle is left, after Eades, Lin and Smyth.

    Args:
        worth: how well a vertex of a cycle fits to the left of the others, by its name and how many
            edges leave it and lead to it.
    """
    outgoing: dict[str, list[str]] = {name: [] for name in names}
    incoming: dict[str, list[str]] = {name: [] for name in outgoing}
    for u, v in edges:
        outgoing[u].append(v)
        incoming[v].append(u)
    out = {name: len(others) for name, others in outgoing.items()}
    into = {name: len(others) for name, others in incoming.items()}
    left, first, last = dict.fromkeys(outgoing), [], []

    def take(name: str) -> None:
        del left[name]
        for other in outgoing[name]:
            into[other] -= 1
        for other in incoming[name]:
            out[other] -= 1

    while left:
        if sink := next((name for name in left if not out[name]), None):
            last.append(sink)
            take(sink)
        else:
            source = next((name for name in left if not into[name]), None)
            best = source or max(left, key=lambda name: worth(name, out[name], into[name]))
            first.append(best)
            take(best)
    rank = {name: i for i, name in enumerate([*first, *reversed(last)])}
    return [rank[u] > rank[v] for u, v in edges]


def choose_columns(shapes: Mapping[str, Shape], edges: Sequence[tuple[str, str]]) -> dict[str, int]:
    """Return each vertex' column: behind all that point to it, near those that it points to."""
    before: dict[str, list[str]] = {name: [] for name in shapes}
    behind: dict[str, list[str]] = {name: [] for name in shapes}
    for u, v in edges:
        before[v].append(u)
        behind[u].append(v)
    found: dict[str, int] = {}
    waiting = {name: len(set_) for name, set_ in before.items()}
    ready = [name for name in shapes if not waiting[name]]
    for name in ready:  # grows while it is read
        start = int(shapes[name].odd)
        found[name] = max((found[u] + 1 for u in before[name]), default=start)
        for other in behind[name]:
            waiting[other] -= 1
            if not waiting[other]:
                ready.append(other)
    for _ in range(3):
        for name in reversed(ready):
            if behind[name] and len(behind[name]) >= len(before[name]):
                found[name] = min(found[v] for v in behind[name]) - 1
        for name in ready:
            if before[name] and len(before[name]) > len(behind[name]):
                found[name] = max(found[u] for u in before[name]) + 1
    return found


def spread_loose(
    shapes: Mapping[str, Shape], edges: Sequence[tuple[str, str]], columns: Mapping[str, int]
) -> dict[str, int]:
    """Return columns in which vertices without edges fill what is empty in their lanes."""
    tied = {name for edge in edges for name in edge}
    found = {name: column for name, column in columns.items() if name in tied}
    loose = [name for name in shapes if name not in tied]
    last = max([*found.values(), 2 * round(len(loose) ** 0.5 / 2)], default=0)
    filled = Counter((shapes[name].group, column) for name, column in found.items())
    for name in loose:
        shape = shapes[name]
        free = range(int(shape.odd), max(last, 1) + 1, 2)
        found[name] = min(free, key=lambda c: filled[shape.group, c])
        filled[shape.group, found[name]] += 1
    return found

"""Orders the vertices of each column so that few edges cross, with a place for edges that pass.

An edge across several columns gets a place in each of them.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from collections.abc import Mapping, Sequence
from itertools import pairwise

import attrs

from rigel_k8s.rosgraph.drawing.columns import Shape

SWEEPS = 12  # passes over all columns, in turns from the left and from the right
PASSAGE = 6.0  # the height of an edge's place in a column


@attrs.define
class Place:
    """A vertex, or the place of an edge in a column that it crosses."""

    column: int
    group: int
    width: float
    height: float
    left: list[int] = attrs.field(factory=list)
    right: list[int] = attrs.field(factory=list)
    y: float = 0.0
    passages: Sequence[int] = ()

    @property
    def passage(self) -> bool:
        """Whether it is an edge's; then `passages` are all of that edge."""
        return bool(self.passages)


def make_places(
    shapes: Mapping[str, Shape], edges: Sequence[tuple[str, str]], columns: Mapping[str, int]
) -> tuple[list[Place], dict[str, int], list[list[int]]]:
    """Return all places, vertex -> its place, and the places that each edge goes through."""
    places: list[Place] = []
    index: dict[str, int] = {}
    for name, shape in shapes.items():
        index[name] = len(places)
        places.append(Place(columns[name], shape.group, shape.width, shape.height))
    chains = []
    for u, v in edges:
        crossed = range(columns[u] + 1, columns[v])
        passages = range(len(places), len(places) + len(crossed))
        # It changes the lane just before its end, where other edges come together as well.
        places += [
            Place(column, shapes[u].group, 0.0, PASSAGE, passages=passages) for column in crossed
        ]
        chain = [index[u], *passages, index[v]]
        for one, other in pairwise(chain):
            places[one].right.append(other)
            places[other].left.append(one)
        chains.append(chain)
    return places, index, chains


def order(places: Sequence[Place]) -> list[list[int]]:
    """Return each column's places from the top, so that few edges cross; lanes stay together."""
    last = max((place.column for place in places), default=-1)
    rows = [[i for i, p in enumerate(places) if p.column == c] for c in range(last + 1)]
    for row in rows:
        row.sort(key=lambda i: places[i].group)
    best, fewest = [list(row) for row in rows], count_crossings(places, rows)
    for sweep in range(SWEEPS):
        to_right = sweep % 2 == 0
        for row in rows if to_right else rows[::-1]:
            sort_row(places, rows, row, to_right=to_right)
        crossings = count_crossings(places, rows)
        if crossings < fewest:
            best, fewest = [list(row) for row in rows], crossings
        if not fewest:
            break
    return best


def sort_row(
    places: Sequence[Place], rows: Sequence[Sequence[int]], row: list[int], *, to_right: bool
) -> None:
    """Sort a column by the middle of what its places are connected to on one side."""
    if not row:
        return
    column = places[row[0]].column
    beside = column - 1 if to_right else column + 1
    if not 0 <= beside < len(rows):
        return
    at = {i: n / max(1, len(rows[beside])) for n, i in enumerate(rows[beside])}
    own = {i: n / len(row) for n, i in enumerate(row)}

    def middle(i: int) -> tuple[int, float]:
        near = places[i].left if to_right else places[i].right
        return places[i].group, sum(at[j] for j in near) / len(near) if near else own[i]

    row.sort(key=middle)


def count_crossings(places: Sequence[Place], rows: Sequence[Sequence[int]]) -> int:
    """Return how often edges between neighbouring columns cross."""
    total = 0
    for row, following in pairwise(rows):
        at = {i: n for n, i in enumerate(following)}
        seen: list[int] = []
        for i in row:
            ends = sorted(at[j] for j in places[i].right)
            total += sum(len(seen) - bisect_right(seen, end) for end in ends)
            for end in ends:
                insort(seen, end)
    return total

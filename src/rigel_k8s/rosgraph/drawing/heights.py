"""Gives each place of a column its height, so that edges are short and straight.

Groups are lanes, one below another, so that no vertex lies in the lane of another group.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import attrs

from rigel_k8s.rosgraph.drawing.rows import Place

SETTLINGS = 40
ROW_GAP = 16.0  # between two vertices of a column
#: Between a vertex and an edge that passes it, and between two edges.
PASSING_GAP, EDGE_GAP = 10.0, 3.0
STRAIGHT = 2.0  # how much more it counts that an edge across columns is level


@attrs.frozen
class Lane:
    """A group's place: top and bottom."""

    top: float
    bottom: float


def choose_lanes(
    places: Sequence[Place], rows: Sequence[Sequence[int]], count: int, *, head: float, gap: float
) -> list[Lane]:
    """Return the lanes, as high as their fullest column."""
    lanes, top = [], 0.0
    for group in range(count):
        needed = max(
            (stack_height([places[i] for i in row if places[i].group == group]) for row in rows),
            default=0.0,
        )
        lanes.append(Lane(top, top + head + needed + ROW_GAP))
        top = lanes[-1].bottom + gap
    return lanes


def stack_height(stack: Sequence[Place]) -> float:
    """Return how high places one below the other are."""
    return offsets_of(stack)[-1] + stack[-1].height / 2 if stack else 0.0


def offsets_of(stack: Sequence[Place]) -> list[float]:
    """Return the middles of places that stand one below the other, as near as they may."""
    found, at = [], 0.0
    for n, place in enumerate(stack):
        if n:
            passing = place.passage + stack[n - 1].passage
            at += (ROW_GAP, PASSING_GAP, EDGE_GAP)[passing]
        found.append(at + place.height / 2)
        at += place.height
    return found


def settle(
    places: Sequence[Place], rows: Sequence[Sequence[int]], lanes: Sequence[Lane], head: float
) -> None:
    """Choose heights so that edges are short and straight, in the columns' order."""
    stacks = []
    for row in rows:
        groups: dict[int, list[Place]] = defaultdict(list)
        for i in row:
            groups[places[i].group].append(places[i])
        stacks += [(lanes[group], stack) for group, stack in groups.items()]
    for lane, stack in stacks:
        top = (lane.top + head + lane.bottom - ROW_GAP - stack_height(stack)) / 2
        for place, offset in zip(stack, offsets_of(stack), strict=True):
            place.y = top + offset
    for turn in range(SETTLINGS):
        for lane, stack in stacks if turn % 2 == 0 else stacks[::-1]:
            wishes = [wish(places, place) for place in stack]
            highest = lane.bottom - ROW_GAP - stack_height(stack)
            fitted = fit(offsets_of(stack), wishes, lane.top + head, highest)
            for place, y in zip(stack, fitted, strict=True):
                place.y = y


def wish(places: Sequence[Place], place: Place) -> tuple[float, float]:
    """Return the wished height of a place, and its weight."""
    near = [places[i].y for i in (*place.left, *place.right)]
    level = [places[i].y for i in place.passages]
    weight = len(near) + STRAIGHT * len(level)
    if not weight:
        return place.y, 0.1
    if level:
        near = [places[places[i].left[0]].y for i in place.passages[:1]]
        near += [places[places[i].right[0]].y for i in place.passages[-1:]]
        weight = len(near) + STRAIGHT * len(level)
    return (sum(near) + STRAIGHT * sum(level)) / weight, weight


def fit(
    offsets: Sequence[float], wishes: Sequence[tuple[float, float]], top: float, lowest: float
) -> list[float]:
    """Return heights near the wishes, in order and apart.

    Neighbours whose wishes are too close together move as one block, to where the sum of the
    squared differences is smallest.

    Args:
        offsets: the heights, counted from where the stack begins, if it stands close together.
        wishes: the height that each should have, and its weight.
        top, lowest: between these the stack begins where it stands close together.
    """
    blocks: list[tuple[float, float, int]] = []  # its wished beginning, weight, number of places
    for offset, (target, weight) in zip(offsets, wishes, strict=True):
        block = (target - offset, weight, 1)
        while blocks and blocks[-1][0] > block[0]:
            begin, much, many = blocks.pop()
            both = much + block[1]
            block = ((begin * much + block[0] * block[1]) / both, both, many + block[2])
        blocks.append(block)
    starts = [
        min(max(begin, top), max(top, lowest)) for begin, _, many in blocks for _ in range(many)
    ]
    return [start + offset for start, offset in zip(starts, offsets, strict=True)]

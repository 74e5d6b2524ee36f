"""Places the vertices of a directed graph in columns from left to right, in lanes by group.

Why our own: a picture must come without Graphviz on the user's machine. The method is Sugiyama's:
edges that close a cycle are turned round, each vertex gets a column behind those that point to it,
an edge across several columns gets a place in each, the order in a column is chosen so that few
edges cross, and heights so that edges are straight. Groups are lanes, one below another, so that
no vertex lies in the lane of another group. The same input gives the same result. It must not know
what the vertices mean.
"""

from __future__ import annotations

from bisect import bisect_right, insort
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise

import attrs

Point = tuple[float, float]

TURNED = 3  # an edge that is turned round counts as one across so many more columns
SWEEPS = 12  # passes over all columns, in turns from the left and from the right
SETTLINGS = 40
ROW_GAP = 16.0  # between two vertices of a column
#: Between a vertex and an edge that passes it, and between two edges.
PASSING_GAP, EDGE_GAP = 10.0, 3.0
COLUMN_GAP, PER_EDGE, WIDEST_GAP = 56.0, 1.5, 120.0  # more room where many edges turn
PASSAGE = 6.0  # the height of an edge's place in a column
STRAIGHT = 2.0  # how much more it counts that an edge across columns is level


@attrs.frozen
class Shape:
    """A vertex: its size, its group's index, and whether it is in an even or an odd column."""

    width: float
    height: float
    group: int
    odd: bool = False


@attrs.frozen
class Lane:
    """A group's place: top and bottom."""

    top: float
    bottom: float


@attrs.frozen
class Layout:
    """Where everything is.

    Attributes:
        centres: of the vertices.
        routes: of each edge the points that it passes, from its start to its end; horizontal at
            each of them.
    """

    width: float
    centres: Mapping[str, Point]
    routes: Sequence[Sequence[Point]]
    lanes: Sequence[Lane]


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


def lay_out(
    shapes: Mapping[str, Shape], edges: Sequence[tuple[str, str]], *, head: float, lane_gap: float
) -> Layout:
    """Return where vertices and edges are, from (0, 0).

    Args:
        shapes: the vertices. Edges lead from an even to an odd column or the other way round.
        head: the room for a title above each lane's vertices.
        lane_gap: between two lanes.
    """
    turned = choose_turned(shapes, edges)
    forward = turn(edges, turned)
    columns = spread_loose(shapes, forward, choose_columns(shapes, forward))
    places, index, chains = make_places(shapes, forward, columns)
    count = max((shape.group for shape in shapes.values()), default=-1) + 1
    rows = order(places)
    lanes = choose_lanes(places, rows, count, head=head, gap=lane_gap)
    settle(places, rows, lanes, head)
    lefts, widths = choose_widths(places, rows)
    centres = {
        name: (lefts[places[i].column] + widths[places[i].column] / 2, places[i].y)
        for name, i in index.items()
    }
    routes = route(places, chains, lefts, widths)
    return Layout(
        width=lefts[-1] + widths[-1] if lefts else 0.0,
        centres=centres,
        routes=[
            points[::-1] if back else points for points, back in zip(routes, turned, strict=True)
        ],
        lanes=lanes,
    )


def turn(edges: Sequence[tuple[str, str]], turned: Sequence[bool]) -> list[tuple[str, str]]:
    """Return edges, some of them turned round."""
    return [(v, u) if back else (u, v) for (u, v), back in zip(edges, turned, strict=True)]


def choose_turned(shapes: Mapping[str, Shape], edges: Sequence[tuple[str, str]]) -> list[bool]:
    """Return which edges are turned round so that no cycle is left: the better of two ways.

    One turns few edges; the other begins where a vertex of the even columns has few inputs, as a
    driver has that only hears commands. The fewer columns edges cross, the better.
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
    """Return which edges are turned round so that no cycle is left, after Eades, Lin and Smyth.

    Args:
        worth: how well a vertex of a cycle stands to the left of the others, by its name and how
            many edges leave it and lead to it.
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
    for name in ready:  # grows while it is gone through
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
        # It leaves its lane in front of its end, where other edges come together as well.
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
    """Return where a place would like to be, and how much."""
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

    Neighbours that want to be too near to each other move as one block, to where the sum of the
    squares of what they miss is smallest.

    Args:
        offsets: the heights, counted from where the stack begins, if it stands close together.
        wishes: where each would like to be, and how much.
        top, lowest: between these the stack begins where it stands close together.
    """
    blocks: list[tuple[float, float, int]] = []  # where it wants to begin, how much, how many
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


def choose_widths(
    places: Sequence[Place], rows: Sequence[Sequence[int]]
) -> tuple[list[float], list[float]]:
    """Return where the columns begin, and how wide they are."""
    widths = [max((places[i].width for i in row), default=0.0) for row in rows]
    lefts, at = [], 0.0
    for row, width in zip(rows, widths, strict=True):
        lefts.append(at)
        turning = sum(len(places[i].right) for i in row)
        at += width + min(WIDEST_GAP, COLUMN_GAP + PER_EDGE * turning)
    return lefts, widths


def route(
    places: Sequence[Place],
    chains: Sequence[Sequence[int]],
    lefts: Sequence[float],
    widths: Sequence[float],
) -> list[list[Point]]:
    """Return the points of each edge: it bends between columns only.

    At a vertex, edges are spread along its side.
    """
    ports = spread_ports(places, chains)
    routes = []
    for number, chain in enumerate(chains):
        points: list[Point] = []
        for step, i in enumerate(chain):
            place, left = places[i], lefts[places[i].column]
            middle, half = left + widths[place.column] / 2, place.width / 2
            if step == 0:
                y = ports[number, 0]
                points += [(middle + half, y), (left + widths[place.column], y)]
            elif step == len(chain) - 1:
                y = ports[number, 1]
                points += [(left, y), (middle - half, y)]
            else:
                points += [(left, place.y), (left + widths[place.column], place.y)]
        routes.append(points)
    return routes


def spread_ports(
    places: Sequence[Place], chains: Sequence[Sequence[int]]
) -> dict[tuple[int, int], float]:
    """Return (edge, 0 for its start or 1 for its end) -> height, by the order of the other ends."""
    sides: dict[tuple[int, int], list[tuple[float, int]]] = defaultdict(list)
    for number, chain in enumerate(chains):
        sides[chain[0], 0].append((places[chain[1]].y, number))
        sides[chain[-1], 1].append((places[chain[-2]].y, number))
    found = {}
    for (i, end), ends in sides.items():
        room = places[i].height * 0.6
        step = min(9.0, room / max(1, len(ends) - 1))
        begin = places[i].y - step * (len(ends) - 1) / 2
        for rank, (_, number) in enumerate(sorted(ends)):
            found[number, end] = begin + rank * step
    return found

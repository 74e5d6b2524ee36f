"""Places the vertices of a directed graph in columns from left to right, in lanes by group.

Why our own: a picture must be possible without Graphviz on the user's machine. The method is
Sugiyama's: columns first (columns.py), then the order in each (rows.py), then heights (heights.py),
and last the edges, which bend between columns only. The same input gives the same result. It is
independent of what the vertices mean.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence

import attrs

from rigel_k8s.rosgraph.drawing.columns import (
    Shape,
    choose_columns,
    choose_turned,
    spread_loose,
    turn,
)
from rigel_k8s.rosgraph.drawing.heights import Lane, choose_lanes, settle
from rigel_k8s.rosgraph.drawing.rows import Place, make_places, order

Point = tuple[float, float]

COLUMN_GAP, PER_EDGE, WIDEST_GAP = 56.0, 1.5, 120.0  # more room where many edges turn


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

"""Rows below heads, as wide as a terminal has room for."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from datetime import datetime, timezone
from itertools import zip_longest

import click

from rigel_k8s.cli.width import find_room, make_printable, shorten, wrap

GAP = "  "
#: Columns that a cell keeps, however narrow the terminal is.
LEAST = 8
#: The same of a cell that goes on in further lines.
WRAPPED = 30


def table(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    optional: Sequence[str] = (),
    colors: Sequence[str | None] = (),
    unbroken: Sequence[str] = (),
    *,
    wrapped: bool = False,
) -> str:
    """Return rows below heads, in columns as wide as their widest cell.

    In a terminal a row is no longer than a line: the first optional column is left out, then the
    widest are narrowed, and where that is not enough, the other optional ones are left out.

    Args:
        colors: of the rows.
        unbroken: columns that are not narrowed; all but the first are if nothing else is left.
        wrapped: the last column's cells go on in further lines instead of losing their middle.
    """
    everything = [list(heads), *[list(map(make_printable, row)) for row in rows]]
    room = find_room(sys.stdout)
    for name in (None, *optional):
        if name in heads:
            left_out = everything[0].index(str(name))
            everything = [[*row[:left_out], *row[left_out + 1 :]] for row in everything]
        whole = [max(map(len, column)) for column in zip(*everything, strict=True)]
        # A narrowed name cannot be copied: rather than that, do without the first column.
        first = name is None and bool(optional)
        kept = unbroken[:1] if optional and name == optional[-1] else unbroken
        least = [
            width if first or head in kept else max(len(head), LEAST)
            for head, width in zip(everything[0], whole, strict=True)
        ]
        if wrapped:  # a word is not broken
            words = [word for row in everything for word in row[-1].split()]
            least[-1] = max(least[-1], WRAPPED, *map(len, words))
        widths = narrow(whole, least, room)
        if room is None or line_width(widths) <= room:
            break
    margin = " " * (line_width(widths) - widths[-1])
    lines = []
    for row in everything:
        cells = [shorten(cell, width).ljust(width) for cell, width in zip(row, widths, strict=True)]
        if wrapped:
            cells[-1] = wrap(row[-1], sys.stdout, len(margin), margin)
        lines.append(GAP.join(cells).rstrip())
    lines[1:] = [
        click.style(line, fg=color) if color else line
        for line, color in zip_longest(lines[1:], colors)
    ]
    return "\n".join(lines)


def line_width(widths: Sequence[int]) -> int:
    """Return the columns that a row takes."""
    return sum(widths) + len(GAP) * (len(widths) - 1)


def narrow(widths: Sequence[int], least: Sequence[int], room: int | None) -> list[int]:
    """Return the widths of columns, the widest ones narrowed, but no further than needed."""
    found = list(widths)
    while room is not None and line_width(found) > room:
        wide = [(width, i) for i, width in enumerate(found) if width > least[i]]
        if not wide:
            break
        found[max(wide)[1]] -= 1
    return found


def seconds_since(time: str, now: datetime) -> int | None:
    """Return how many seconds ago a Kubernetes time was, None if it is none."""
    try:
        then = datetime.strptime(time, "%Y-%m-%dT%H:%M:%SZ").replace(tzinfo=timezone.utc)
    except ValueError:
        return None
    return max(0, int((now - then).total_seconds()))


def age(created: str, now: datetime) -> str:
    """Return how long ago a Kubernetes time was: 42s, 12m, 5h, 3d."""
    seconds = seconds_since(created, now)
    if seconds is None:
        return "-"
    for unit, size in (("d", 86400), ("h", 3600), ("m", 60)):
        if seconds >= 2 * size:
            return f"{seconds // size}{unit}"
    return f"{seconds}s"

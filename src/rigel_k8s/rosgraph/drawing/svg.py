"""A picture as SVG, light or dark as the reader's browser is.

Why no library: it is text, and must open anywhere without external fonts, scripts or styles. Text
has room for the widest of the usual fonts, so that it never runs over its box. All names are
escaped. layout.py places everything.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.sax.saxutils import escape, quoteattr

from rigel_k8s.rosgraph.drawing.columns import Shape
from rigel_k8s.rosgraph.drawing.layout import Layout, Point, lay_out
from rigel_k8s.rosgraph.drawing.picture import Arrow, Box, Picture, Pill, show_name

MARGIN, HEAD, LANE_GAP, LANE_PAD = 24.0, 40.0, 14.0, 18.0
TITLE, LINE = 44.0, 20.0  # the heights of the title and of a problem's line
BOX_HEIGHT, PILL_HEIGHT, SINGLE = 46.0, 40.0, 28.0
LARGE, SMALL = 13.0, 11.0  # sizes of letters
LONGEST = 46  # letters of a name; the tooltip has all
SIDE = 14.0  # between a text and the side of its box
NARROWEST = 320.0

STYLE = """
svg { --page: #ffffff; --lane: #f4f6f9; --line: #dce1e8; --ink: #1b2330; --soft: #5d6878;
  --box: #ffffff; --edge: #9aa6b5; --rim: #b4bfcc; --pill: #e3eefc; --pillrim: #a9c8ee;
  --pillink: #12416f; --bad: #cf2130; --badfill: #fdecec; background: var(--page) }
@media (prefers-color-scheme: dark) {
svg { --page: #0e131a; --lane: #161d27; --line: #273140; --ink: #e8edf4; --soft: #93a0b1;
  --box: #202a37; --edge: #5f6e81; --rim: #40505f; --pill: #16304c; --pillrim: #2f5b8a;
  --pillink: #b5d6fa; --bad: #ff6b6b; --badfill: #3a1d22 } }
text { font-family: system-ui, -apple-system, "Segoe UI", Roboto, Helvetica, Arial, sans-serif }
.page { fill: var(--page) } .lane { fill: var(--lane); stroke: var(--line) }
.title { font-size: 17px; font-weight: 600; fill: var(--ink) }
.machine { font-size: 12px; font-weight: 600; fill: var(--soft) }
.name { font-size: 13px; font-weight: 600; fill: var(--ink); text-anchor: middle }
.topic { font-size: 13px; fill: var(--pillink); text-anchor: middle }
.note { font-size: 11px; fill: var(--soft); text-anchor: middle }
.summary { font-size: 12px; fill: var(--soft) }
.box { fill: var(--box); stroke: var(--rim) } .pill { fill: var(--pill); stroke: var(--pillrim) }
.bad .box, .bad .pill { fill: var(--badfill); stroke: var(--bad) }
.missing .box { stroke-dasharray: 5 4 }
.bad .name, .bad .topic, .bad .note, .problem { fill: var(--bad) } .problem { font-size: 12px }
.arrow { fill: none; stroke: var(--edge); stroke-width: 1.4 } .arrow.bad { stroke: var(--bad) }
.arrow:hover { stroke-width: 3 }
.tip { fill: var(--edge) } .tip.bad { fill: var(--bad) }
"""


def write_svg(picture: Picture) -> str:
    """Return a picture as an SVG document."""
    groups = {title: number for number, title in enumerate(picture.groups)}
    shapes = {node_key(box.name): shape_box(box, groups[box.group]) for box in picture.boxes}
    shapes |= {topic_key(pill.name): shape_pill(pill, groups[pill.group]) for pill in picture.pills}
    edges = [ends(arrow) for arrow in picture.arrows]
    made = lay_out(shapes, edges, head=HEAD, lane_gap=LANE_GAP)
    lane_width = max(made.width + 2 * LANE_PAD, NARROWEST)
    bottom = made.lanes[-1].bottom if made.lanes else 0.0
    width = max(
        lane_width + 2 * MARGIN, *(measure(text, 12.0) + 2 * MARGIN for text in texts(picture))
    )
    height = TITLE + MARGIN + bottom + MARGIN + LINE * len(picture.problems)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}"'
        f' viewBox="0 0 {width:.0f} {height:.0f}" role="img">',
        f"<title>{escape(picture.title)}</title>",
        f"<style>{STYLE}</style>",
        f"<defs>{marker('tip', '')}{marker('badtip', ' bad')}</defs>",
        '<rect class="page" width="100%" height="100%"/>',
        *write_heading(picture),
        f'<g transform="translate({MARGIN:g} {TITLE + MARGIN / 2:g})">',
        *write_lanes(picture, made, lane_width),
        f'<g transform="translate({LANE_PAD:g} 0)">',
        *(write_arrow(a, points) for a, points in zip(picture.arrows, made.routes, strict=True)),
        *(write_box(box, made, shapes[node_key(box.name)]) for box in picture.boxes),
        *(write_pill(pill, made, shapes[topic_key(pill.name)]) for pill in picture.pills),
        "</g></g>",
        *write_problems(picture, TITLE + MARGIN + bottom + LINE),
        "</svg>",
    ]
    return "\n".join(parts) + "\n"


def node_key(name: str) -> str:
    """Return the key of a node in the layout: a topic may have the same name."""
    return f"node {name}"


def topic_key(name: str) -> str:
    """Return the key of a topic in the layout."""
    return f"topic {name}"


def ends(arrow: Arrow) -> tuple[str, str]:
    """Return where an arrow begins and ends."""
    node, topic = node_key(arrow.node), topic_key(arrow.topic)
    return (node, topic) if arrow.out else (topic, node)


def shape_box(box: Box, group: int) -> Shape:
    """Return a node's size."""
    width = max(measure(shorten(box.name), LARGE, bold=True), measure(shorten(box.note), SMALL))
    return Shape(width + 2 * SIDE, BOX_HEIGHT if box.note else SINGLE + 4, group)


def shape_pill(pill: Pill, group: int) -> Shape:
    """Return a topic's size."""
    name, note = shorten(show_name(pill.name)), pill_note(pill)
    width = max(measure(name, LARGE), measure(note, SMALL))
    return Shape(width + 2 * (SIDE + 6), PILL_HEIGHT if note else SINGLE, group, odd=True)


def pill_note(pill: Pill) -> str:
    """Return a topic's second line: its type and rate."""
    return "  ·  ".join(filter(None, [shorten(pill.type), pill.rate]))


def measure(text: str, size: float, *, bold: bool = False) -> float:
    """Return how wide a text is in the widest of the usual fonts, in pixels."""
    return sum(letter_width(letter) for letter in text) * size * (1.08 if bold else 1.0)


def letter_width(letter: str) -> float:
    """Return a letter's width in a font of size 1, as DejaVu Sans and Segoe UI at most have it."""
    if letter in "il|!.,:;'jI ()[]/·":
        return 0.4
    if letter in "mwMW@%—":
        return 0.98
    if ord(letter) > 0x2E80:
        return 1.05  # Chinese, Japanese and Korean letters are squares
    return 0.72 if letter.isupper() else 0.62


def shorten(text: str) -> str:
    """Return a text short enough for a box: its beginning and its end."""
    if len(text) <= LONGEST:
        return text
    half = (LONGEST - 1) // 2
    return f"{text[:half]}…{text[-half:]}"


def texts(picture: Picture) -> Iterator[str]:
    """Yield the lines above and below the graph."""
    yield f"{picture.title}{summarize(picture)}" + " " * 24
    yield from picture.problems


def summarize(picture: Picture) -> str:
    """Return how much there is."""
    counts = [
        (len(picture.boxes), "node"),
        (len(picture.pills), "topic"),
        (len(picture.problems), "problem"),
    ]
    return ", ".join(f"{count} {what}{'s' * (count != 1)}" for count, what in counts if count)


def marker(name: str, more: str) -> str:
    """Return an arrow's tip."""
    return (
        f'<marker id="{name}" viewBox="0 0 8 8" refX="7.5" refY="4" markerWidth="8"'
        f' markerHeight="8" markerUnits="userSpaceOnUse" orient="auto">'
        f'<path class="tip{more}" d="M0 0.5 L8 4 L0 7.5 L1.8 4 z"/></marker>'
    )


def write_heading(picture: Picture) -> Iterator[str]:
    """Yield the title, and how much there is."""
    yield (
        f'<text x="{MARGIN:g}" y="34"><tspan class="title">{escape(picture.title)}</tspan>'
        f'<tspan class="summary" dx="14">{summarize(picture)}</tspan></text>'
    )


def write_lanes(picture: Picture, made: Layout, width: float) -> Iterator[str]:
    """Yield the background of each group, and its title."""
    for title, lane in zip(picture.groups, made.lanes, strict=True):
        yield (
            f'<rect class="lane" y="{lane.top:g}" width="{width:.1f}"'
            f' height="{lane.bottom - lane.top:.1f}" rx="12"/>'
            f'<text class="machine" x="{LANE_PAD:g}" y="{lane.top + 24:g}">{escape(title)}</text>'
        )


def write_arrow(arrow: Arrow, points: Sequence[Point]) -> str:
    """Return an arrow: curves that are horizontal at each of the points."""
    tip, more = ("badtip", " bad") if arrow.bad else ("tip", "")
    words = (
        f"{arrow.node} publishes {arrow.topic}"
        if arrow.out
        else f"{arrow.node} subscribes to {arrow.topic}"
    )
    return (
        f'<path class="arrow{more}" d="{curve(points)}" marker-end="url(#{tip})">'
        f"<title>{escape(words)}</title></path>"
    )


def curve(points: Sequence[Point]) -> str:
    """Return a path through the points: straight where they are level, else an S.

    If a point occurred twice, the arrow's tip would have no direction.
    """
    x, y = points[0]
    steps = [f"M{x:.1f} {y:.1f}"]
    for next_x, next_y in points[1:]:
        if abs(next_x - x) < 0.05:
            continue
        if abs(next_y - y) < 0.05:
            steps.append(f"L{next_x:.1f} {next_y:.1f}")
        else:
            middle = (x + next_x) / 2
            steps.append(
                f"C{middle:.1f} {y:.1f} {middle:.1f} {next_y:.1f} {next_x:.1f} {next_y:.1f}"
            )
        x, y = next_x, next_y
    return "".join(steps)


def write_box(box: Box, made: Layout, shape: Shape) -> str:
    """Return a node."""
    x, y = made.centres[node_key(box.name)]
    look = " ".join(filter(None, ["node", "bad" * box.bad, "missing" * box.missing]))
    return (
        f'<g class="{look}" transform="translate({x:.1f} {y:.1f})">'
        f"<title>{escape(' '.join(filter(None, [box.name, box.note])))}</title>"
        f"{outline('box', shape, 8.0)}{two_lines('name', box.name, box.note)}</g>"
    )


def write_pill(pill: Pill, made: Layout, shape: Shape) -> str:
    """Return a topic."""
    x, y = made.centres[topic_key(pill.name)]
    look = "bad" if pill.bad else "good"
    return (
        f'<g class={quoteattr(look)} transform="translate({x:.1f} {y:.1f})">'
        f"<title>{escape(' '.join(filter(None, [pill.name, pill.type, pill.rate])))}</title>"
        f"{outline('pill', shape, shape.height / 2)}"
        f"{two_lines('topic', show_name(pill.name), pill_note(pill))}</g>"
    )


def outline(name: str, shape: Shape, radius: float) -> str:
    """Return a rounded rectangle around (0, 0)."""
    return (
        f'<rect class="{name}" x="{-shape.width / 2:.1f}" y="{-shape.height / 2:.1f}"'
        f' width="{shape.width:.1f}" height="{shape.height:.1f}" rx="{radius:g}"/>'
    )


def two_lines(name: str, first: str, second: str) -> str:
    """Return a name and the note below it, around (0, 0)."""
    if not second:
        return f'<text class="{name}" y="4.5">{escape(shorten(first))}</text>'
    return (
        f'<text class="{name}" y="-3">{escape(shorten(first))}</text>'
        f'<text class="note" y="13">{escape(second if name == "topic" else shorten(second))}</text>'
    )


def write_problems(picture: Picture, top: float) -> Iterator[str]:
    """Yield a line for each problem."""
    for number, message in enumerate(picture.problems):
        y = top + LINE * number
        yield f'<text class="problem" x="{MARGIN:g}" y="{y:.1f}">{escape(message)}</text>'

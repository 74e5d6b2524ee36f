"""Draws screens of a terminal as one SVG: it shows each for some seconds, in a loop."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from itertools import pairwise

from rich.color import ColorType
from rich.style import Style
from rich.text import Text

from tools.recording.commands import COLUMNS, Run

ROWS = 24
WIDTH, HEIGHT, MARGIN = 8.45, 19, 18
#: Seconds until the output begins, and how long each screen stays after its last line.
TYPED, STAYS = 0.8, 4.0
STYLE = """
    .page { fill: #ffffff; stroke: #d1d9e0; rx: 8 }
    text { font: 14px ui-monospace, "DejaVu Sans Mono", monospace; fill: #1f2328; white-space: pre }
    .bold { font-weight: 600 } .dim { fill: #59636e }
    .c1 { fill: #cf222e } .c2 { fill: #116329 } .c3 { fill: #9a6700 }
    .c4 { fill: #0969da } .c5 { fill: #8250df } .c6 { fill: #1b7c83 }
    @media (prefers-color-scheme: dark) {
      .page { fill: #0d1117; stroke: #3d444d } text { fill: #e6edf3 } .dim { fill: #9198a1 }
      .c1 { fill: #ff7b72 } .c2 { fill: #3fb950 } .c3 { fill: #d29922 }
      .c4 { fill: #58a6ff } .c5 { fill: #bc8cff } .c6 { fill: #39c5cf }
    }
"""


def draw(title: str, runs: Sequence[Run]) -> str:
    """Return the picture. For readers who prefer no motion, it is the last screen."""
    screens = [Text.from_ansi(run.output).split("\n")[:ROWS] for run in runs]
    lengths = [TYPED + 0.12 * len(lines) + STAYS for lines in screens]
    width = round(COLUMNS * WIDTH + 2 * MARGIN)
    height = (max(map(len, screens)) + 2) * HEIGHT + MARGIN
    body: list[str] = []
    for number, (run, lines) in enumerate(zip(runs, screens, strict=True)):
        body += _screen(number, run.command, lines, last=number == len(runs) - 1)
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">',
            f"  <title>{escape(title)}</title>",
            f"  <style>{STYLE}{''.join(_motion(lengths))}  </style>",
            f'  <rect class="page" x="1" y="1" width="{width - 2}" height="{height - 2}"/>',
            *body,
            "</svg>",
            "",
        ]
    )


def _motion(lengths: Sequence[float]) -> Iterator[str]:
    """Yield the rules that show each screen in its turn, again and again."""
    whole = sum(lengths)
    begin = 0.0
    yield "    @media (prefers-reduced-motion: no-preference) {\n"
    for number, length in enumerate(lengths):
        first, last = 100 * begin / whole, 100 * (begin + length) / whole
        output = 100 * (begin + TYPED) / whole
        yield f"      #s{number} {{ animation: s{number} {whole:.1f}s infinite }}\n"
        yield (
            f"      @keyframes s{number} {{ 0%, {first:.2f}% {{ visibility: hidden }}"
            f" {first + 0.01:.2f}%, {last - 0.01:.2f}% {{ visibility: visible }}"
            f" {last:.2f}%, 100% {{ visibility: hidden }} }}\n"
        )
        yield f"      #o{number} {{ animation: o{number} {whole:.1f}s infinite }}\n"
        yield (
            f"      @keyframes o{number} {{ 0%, {output:.2f}% {{ visibility: hidden }}"
            f" {output + 0.01:.2f}%, 100% {{ visibility: inherit }} }}\n"
        )
        begin += length
    yield "    }\n"


def _screen(number: int, command: str, lines: Sequence[Text], *, last: bool) -> Iterator[str]:
    hidden = "" if last else ' visibility="hidden"'
    yield f'  <g id="s{number}"{hidden}>'
    prompt = f'<tspan class="c2 bold">$</tspan> <tspan class="bold">{escape(command)}</tspan>'
    yield f'    <text x="{MARGIN}" y="{MARGIN + HEIGHT // 2 + 4}">{prompt}</text>'
    yield f'    <g id="o{number}">'
    for row, line in enumerate(lines, 1):
        y = MARGIN + HEIGHT // 2 + 4 + row * HEIGHT
        yield f'      <text x="{MARGIN}" y="{y}">{_spans(line)}</text>'
    yield "    </g>"
    yield "  </g>"


def _spans(line: Text) -> str:
    """Return a line's pieces, each with the classes of its color and weight."""
    found: list[str] = []
    edges = sorted(
        {0, len(line), *(edge for span in line.spans for edge in (span.start, span.end))}
    )
    for begin, end in pairwise(edges):
        styles = [Style.parse(str(one.style)) for one in line.spans if one.start <= begin < one.end]
        names = _classes(Style.combine(styles)) if styles else ""
        words = escape(line.plain[begin:end])
        found.append(f'<tspan class="{names}">{words}</tspan>' if names else words)
    return "".join(found)


def _classes(style: Style) -> str:
    names = [name for name, on in (("bold", style.bold), ("dim", style.dim)) if on]
    color = style.color
    if color is not None and color.type is ColorType.STANDARD and color.number:
        names.append(f"c{color.number % 8}")
    return " ".join(names)

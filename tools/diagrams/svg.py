"""Shapes and texts as SVG. The reader's browser chooses the light or the dark form."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

LINE = 17
STYLE = """
    text { font: 14px system-ui, sans-serif; fill: #1f2328 }
    .middle { text-anchor: middle }
    .small { font-size: 12px; fill: #59636e }
    .bold { font-weight: 600 }
    rect { fill: #f6f8fa; stroke: #8b949e; rx: 7 }
    .frame { fill: none; stroke-dasharray: 5 4 }
    .note { fill: #ddf4ff; stroke: #54aeff; rx: 3 }
    .good { fill: #dafbe1; stroke: #4ac26b }
    path { fill: none; stroke: #57606a; stroke-width: 1.4 }
    .dashed { stroke-dasharray: 6 4 }
    .life { stroke: #8b949e; stroke-width: 1; stroke-dasharray: 2 4 }
    .bad { stroke: #cf222e }
    text.bad { fill: #cf222e; stroke: none }
    marker path { fill: #57606a; stroke: none }
    @media (prefers-color-scheme: dark) {
      text { fill: #e6edf3 } .small { fill: #9198a1 }
      rect { fill: #161b22; stroke: #6e7681 } .frame { fill: none }
      .note { fill: #121d2f; stroke: #388bfd } .good { fill: #12261e; stroke: #2ea043 }
      path { stroke: #9198a1 } marker path { fill: #9198a1 }
      .bad { stroke: #f85149 } text.bad { fill: #f85149 }
    }
"""


def draw(title: str, width: int, height: int, shapes: Iterable[str]) -> str:
    """Return a picture."""
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">',
            f"  <title>{escape(title)}</title>",
            f"  <style>{STYLE}  </style>",
            '  <defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8"'
            ' markerHeight="8" orient="auto"><path d="M0 0 L8 4 L0 8 z"/></marker></defs>',
            *(f"  {shape}" for shape in shapes),
            "</svg>",
            "",
        ]
    )


def rect(x: int, y: int, width: int, height: int, kind: str = "") -> str:
    """Return a rectangle with round corners."""
    return f'<rect class="{kind}" x="{x}" y="{y}" width="{width}" height="{height}"/>'


def text(x: int, y: int, words: str, kind: str = "") -> str:
    """Return a line of text; `y` is its base line."""
    return f'<text class="{kind}" x="{x}" y="{y}">{escape(words)}</text>'


def line(x1: int, y1: int, x2: int, y2: int, kind: str = "", *, tip: bool = True) -> str:
    """Return a straight line, by default with an arrow's tip at its end."""
    end = ' marker-end="url(#tip)"' if tip else ""
    return f'<path class="{kind}" d="M{x1} {y1} L{x2} {y2}"{end}/>'

"""A picture in DOT: the one description that Graphviz lays out, in a file and in the page.

`rigel graph --to graph.svg` passes it to the program `dot`, the page of `rigel ui` to Graphviz in
the browser. So both agree, and lines are routed around boxes.
"""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.rosgraph.drawing.picture import Box, Picture, Pill, show_name

BAD = 'color="#cf2130", fontcolor="#cf2130"'


def write_dot(picture: Picture) -> str:
    """Return a picture as a DOT document.

    A topic whose nodes are all on one machine is in that machine's cluster.
    """
    lines = [
        "digraph ros {",
        f"  graph [rankdir=LR, fontname=Helvetica, labelloc=t, label={quote(picture.title)}];",
        '  node [shape=box, fontname=Helvetica, margin="0.22,0.08", color="#8794a5"];',
        '  edge [color="#8794a5", arrowsize=0.7];',
    ]
    for number, group in enumerate(picture.groups):
        inside = [write_box(box) for box in picture.boxes if box.group == group]
        inside += [write_pill(p) for p in picture.pills if p.group == group and not p.shared]
        lines += [
            f"  subgraph cluster_{number} {{",
            f'    label={quote(group)}; labeljust=l; style="rounded,filled";'
            ' color="#dce1e8"; fillcolor="#f4f6f9";',
            *(f"    {line}" for line in inside),
            "  }",
        ]
    lines += [f"  {write_pill(pill)}" for pill in picture.pills if pill.shared]
    lines += [f"  {line}" for line in write_arrows(picture)]
    return "\n".join([*lines, "}"]) + "\n"


def write_box(box: Box) -> str:
    """Return a node."""
    style = "filled,dashed" if box.missing else "filled"
    more = [BAD] if box.bad else []
    words = [f"label={lines(box.name, box.note)}", f'style="{style}"']
    return f"{quote('node ' + box.name)} [{', '.join([*words, 'fillcolor=white', *more])}];"


def write_pill(pill: Pill) -> str:
    """Return a topic."""
    more = [BAD] if pill.bad else []
    words = [f"label={lines(show_name(pill.name), pill.type, pill.rate)}"]
    look = ['style="rounded,filled"', 'fillcolor="#e3eefc"']
    return f"{quote('topic ' + pill.name)} [{', '.join([*words, *look, *more])}];"


def write_arrows(picture: Picture) -> Iterator[str]:
    """Yield the edges."""
    for arrow in picture.arrows:
        ends = [quote(f"node {arrow.node}"), quote(f"topic {arrow.topic}")]
        one, other = ends if arrow.out else ends[::-1]
        yield f"{one} -> {other}" + (' [color="#cf2130"];' if arrow.bad else ";")


def lines(*texts: str) -> str:
    """Return a label of several lines."""
    return '"' + "\\n".join(escape(text) for text in texts if text) + '"'


def quote(text: str) -> str:
    """Return a text as DOT writes it."""
    return f'"{escape(text)}"'


def escape(text: str) -> str:
    """Return a text between DOT's quotes; a backslash would begin an escape sequence."""
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", " ")

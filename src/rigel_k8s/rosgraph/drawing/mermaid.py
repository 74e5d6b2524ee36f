"""A picture in Mermaid, which GitHub and GitLab draw in Markdown."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.rosgraph.drawing.picture import Box, Picture, Pill, show_name

#: Mermaid reads `#name;` and `#number;` as a letter; these would end a label or begin a tag.
LETTERS = {"#": "#35;", '"': "#quot;", "<": "#lt;", ">": "#gt;", "`": "#96;", "&": "#amp;"}
STYLES = (
    "classDef bad stroke:#cf2130,color:#cf2130",
    "classDef missing stroke:#cf2130,color:#cf2130,stroke-dasharray:5 4",
)


def write_mermaid(picture: Picture) -> str:
    """Return a picture as a Mermaid flowchart.

    A topic whose nodes are all on one machine is in that machine's subgraph.
    """
    nodes = {box.name: f"n{number}" for number, box in enumerate(picture.boxes)}
    topics = {pill.name: f"t{number}" for number, pill in enumerate(picture.pills)}
    lines = ["flowchart LR"]
    for number, group in enumerate(picture.groups):
        lines.append(f'  subgraph g{number}["{escape(group)}"]')
        lines += [f"    {write_box(b, nodes)}" for b in picture.boxes if b.group == group]
        lines += [
            f"    {write_pill(pill, topics)}"
            for pill in picture.pills
            if pill.group == group and not pill.shared
        ]
        lines.append("  end")
    lines += [f"  {write_pill(pill, topics)}" for pill in picture.pills if pill.shared]
    for arrow in picture.arrows:
        ends = [nodes[arrow.node], topics[arrow.topic]]
        one, other = ends if arrow.out else ends[::-1]
        lines.append(f"  {one} --> {other}")
    bad = [str(number) for number, arrow in enumerate(picture.arrows) if arrow.bad]
    if bad:
        lines.append(f"  linkStyle {','.join(bad)} stroke:#cf2130")
    lines += [f"  {style}" for style in STYLES]
    return "\n".join(lines) + "\n"


def write_box(box: Box, names: Mapping[str, str]) -> str:
    """Return a node."""
    look = ":::missing" if box.missing else ":::bad" if box.bad else ""
    return f'{names[box.name]}["{label(box.name, box.note)}"]{look}'


def write_pill(pill: Pill, names: Mapping[str, str]) -> str:
    """Return a topic."""
    text = label(show_name(pill.name), pill.type, pill.rate)
    return f'{names[pill.name]}(["{text}"]){":::bad" if pill.bad else ""}'


def label(*texts: str) -> str:
    """Return a label of several lines."""
    return "<br/>".join(escape(text) for text in texts if text)


def escape(text: str) -> str:
    """Return a text between Mermaid's quotes."""
    return "".join(LETTERS.get(letter, letter) for letter in text)

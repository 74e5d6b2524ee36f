"""A picture of a ROS graph: what it shows, and its description in DOT; pure.

What each node has (its log, its parameter events) hides the rest of a graph, and is left out unless
everything is requested. DOT is the one description that Graphviz lays out, so all pictures agree:
`rigel graph --to graph.svg` passes it to the program `dot`, the page of `rigel ui` to Graphviz in
the browser.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping

import attrs

from rigel_graph.problems import topic_of
from rigel_graph.types import FEEDBACK, GraphNode, GraphTopic, RosGraph
from rigel_k8s.problems import Problem

#: The node that collects logs in ROS 1.
QUIET_NODE = "/rosout"
BAD = 'color="#cf2130", fontcolor="#cf2130"'
#: Characters that no text has in DOT, and those that no name of an item has.
CONTROL, ODD = re.compile(r"[\0-\x1f]"), re.compile(r'[\0-\x1f%"\\&]')
ELSEWHERE, NOWHERE = "outside the release", "on no machine"


@attrs.frozen
class Box:
    """A node.

    Attributes:
        where: its pod, or its address.
        wrong: what is wrong with itself.
        bad: something is wrong with it or with one of its topics' types.
        missing: the release expects it and it is not in the graph.
    """

    name: str
    group: str
    where: str = ""
    wrong: str = ""
    bad: bool = False
    missing: bool = False

    @property
    def note(self) -> str:
        """Its second line."""
        return self.wrong or self.where


@attrs.frozen
class Pill:
    """A topic; `shared`: nodes of several groups have it.

    Attributes:
        group: that of its publishers, or of its subscribers if it has none.
    """

    name: str
    group: str
    type: str = ""
    rate: str = ""
    bad: bool = False
    shared: bool = False


@attrs.frozen
class Arrow:
    """From a node to a topic that it publishes (`out`), or from a topic to a subscriber."""

    node: str
    topic: str
    out: bool
    bad: bool = False


@attrs.frozen
class Picture:
    """What is shown; `groups` are titles, in their order: each has a box or a pill."""

    title: str
    groups: tuple[str, ...]
    boxes: tuple[Box, ...]
    pills: tuple[Pill, ...]
    arrows: tuple[Arrow, ...]


def make_picture(
    graph: RosGraph,
    problems: Iterable[Problem] = (),
    *,
    title: str = "",
    everything: bool = False,
) -> Picture:
    """Return what a picture shows.

    Args:
        everything: also show what each node has, and ROS 2's hidden topics.
    """
    found = tuple(problems)
    bad_nodes = {name for p in found if p.kind != "no-publisher" for name in p.subjects}
    bad_topics = {topic_of(p): p.subjects for p in found if p.path}
    topics = [topic for topic in graph.topics if everything or topic.is_public]
    busy = {name for topic in topics for name in (*topic.publishers, *topic.subscribers)}
    known = {node.name: node for node in graph.nodes}
    # An endpoint of a node that has just left is reported a moment longer than the node.
    strangers = [GraphNode(name) for name in sorted(busy - set(known))]
    boxes = tuple(
        Box(
            node.name,
            group_of(node),
            where=node.pod or node.address,
            wrong=describe(node),
            bad=node.name in bad_nodes,
            missing=not node.registered,
        )
        for node in (*graph.nodes, *strangers)
        if everything or node.name != QUIET_NODE or node.name in busy | bad_nodes
    )
    places = {box.name: box.group for box in boxes}
    pills = tuple(make_pill(topic, places, bad=topic.name in bad_topics) for topic in topics)
    arrows = tuple(
        Arrow(node, topic.name, out, node in bad_topics.get(topic.name, ()))
        for topic in topics
        for out, nodes in ((True, topic.publishers), (False, topic.subscribers))
        for node in nodes
    )
    groups = tuple(
        sorted({box.group for box in boxes}, key=lambda g: (g in (ELSEWHERE, NOWHERE), g))
    )
    return Picture(title, groups, boxes, pills, arrows)


def group_of(node: GraphNode) -> str:
    """Return the title of a node's group."""
    if node.machine:
        return node.machine
    return NOWHERE if not node.registered or node.pod else ELSEWHERE


def describe(node: GraphNode) -> str:
    """Return what is wrong with a node itself."""
    if not node.registered:
        return "not in the graph"
    if not node.up:
        return "does not answer"
    if not node.ready:
        return "its pod is not ready"
    return ""


def make_pill(topic: GraphTopic, places: Mapping[str, str], *, bad: bool) -> Pill:
    owners = topic.publishers or topic.subscribers
    groups = Counter(places[name] for name in owners)
    everywhere = {places[name] for name in (*topic.publishers, *topic.subscribers)}
    name, kind = topic.name, topic.type
    if name.endswith(FEEDBACK):
        kind = kind.removesuffix("_FeedbackMessage")
    return Pill(
        name,
        min(groups, key=lambda group: (-groups[group], group)),
        kind,
        "" if topic.rate is None else format_rate(topic.rate),
        bad,
        len(everywhere) > 1,
    )


def show_name(topic: str) -> str:
    """Return the name of a topic in a picture."""
    return f"{topic.removesuffix(FEEDBACK)} (action)" if topic.endswith(FEEDBACK) else topic


def format_rate(value: float) -> str:
    """Return messages a second: 0.25/s, 9.8/s, 120/s."""
    if value >= 100:
        return f"{value:.0f}/s"
    return f"{value:.1f}/s" if value >= 1 else f"{value:.2g}/s"


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
    for arrow in picture.arrows:
        ends = [identify(f"node {arrow.node}"), identify(f"topic {arrow.topic}")]
        one, other = ends if arrow.out else ends[::-1]
        lines.append(f"  {one} -> {other}" + (' [color="#cf2130"];' if arrow.bad else ";"))
    return "\n".join([*lines, "}"]) + "\n"


def write_box(box: Box) -> str:
    style = "filled,dashed" if box.missing else "filled"
    more = [BAD] if box.bad else []
    words = [f"label={lines(box.name, box.note)}", f'style="{style}"']
    return f"{identify('node ' + box.name)} [{', '.join([*words, 'fillcolor=white', *more])}];"


def write_pill(pill: Pill) -> str:
    more = [BAD] if pill.bad else []
    words = [f"label={lines(show_name(pill.name), pill.type, pill.rate)}"]
    look = ['style="rounded,filled"', 'fillcolor="#e3eefc"']
    return f"{identify('topic ' + pill.name)} [{', '.join([*words, *look, *more])}];"


def lines(*texts: str) -> str:
    """Return a label of several lines."""
    return '"' + "\\n".join(escape(text) for text in texts if text) + '"'


def quote(text: str) -> str:
    """Return a text as DOT writes it."""
    return f'"{escape(text)}"'


def identify(text: str) -> str:
    """Return the name of an item: what DOT has no way to write is in it as in a URL."""
    return '"' + ODD.sub(lambda found: f"%{ord(found[0]):02X}", text) + '"'


def escape(text: str) -> str:
    """Return a text between DOT's quotes; a backslash would begin an escape sequence."""
    return CONTROL.sub(" ", text.replace("\\", "\\\\").replace('"', '\\"'))

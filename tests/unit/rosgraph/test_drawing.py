"""What is drawn of a graph, in each form; the golden files are what users get.

`pytest tests/unit/rosgraph --update-golden` writes them again: let Graphviz draw the DOT then.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import attrs
import click
import pytest

from rigel_graph.cli.graph import FORMS, render
from rigel_graph.commands.graph import picture_of
from rigel_graph.drawing import make_picture, write_dot
from rigel_graph.types import RosGraph

from .graphs import ODD, ROBOT, live

GOLDEN = Path(__file__).parent / "golden"


def list_items(text: str) -> str:
    """Return a graph in JSON with a line for each item."""
    lines = []
    for key, value in json.loads(text).items():
        items = value if isinstance(value, list) else [value]
        lines += [f"{key} {json.dumps(item)}\n" for item in items]
    return "".join(lines)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["robot", "odd"])
def test_each_form_is_as_its_golden_file(name: str, form: str, *, update_golden: bool) -> None:
    graph = live({"robot": ROBOT, "odd": ODD}[name])
    file = GOLDEN / f"{name}.{form}"
    text = render(graph, form, everything=False)
    if (name, form) == ("robot", "json"):  # its layout is that of odd.json
        text, file = list_items(text), file.with_suffix(".items")
    if update_golden:
        file.write_text(text, encoding="utf-8")
    assert text == file.read_text(encoding="utf-8")


@pytest.mark.programs
def test_the_same_graph_is_drawn_the_same_in_each_process() -> None:
    """Whatever order sets have in it."""
    code = (
        "from tests.unit.rosgraph.graphs import *\n"
        "from rigel_graph.cli.graph import render\n"
        "graph = live(make_random(2))\n"
        "print(*(render(graph, f, everything=True) for f in ('text', 'dot')))"
    )
    root = Path(__file__).parents[3]
    told = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={"PYTHONHASHSEED": seed, "PYTHONPATH": f"{root / 'src'}:{root}"},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(told) == 1


def test_what_each_node_has_is_left_out_unless_asked_for() -> None:
    """An action is shown by its feedback; its other topics, and /rosout, are hidden."""
    shown = picture_of(live(ROBOT))
    assert {"/rosout", "/plan/_action/status"}.isdisjoint(pill.name for pill in shown.pills)
    assert "/rosout" not in {box.name for box in shown.boxes}
    assert "/plan (action)" in write_dot(shown)
    everything = picture_of(live(ROBOT), everything=True)
    assert len(everything.pills) == len(ROBOT.topics)
    assert len(everything.boxes) == len(ROBOT.nodes)


def test_an_endpoint_of_a_node_that_has_just_left_is_drawn() -> None:
    """The graph is read while it changes."""
    gone = RosGraph(topics=ROBOT.topics[:1])
    assert {box.name for box in make_picture(gone).boxes} == {"/base", "/controller"}


def test_a_name_has_one_line_and_no_commands_for_the_terminal() -> None:
    """A ROS master takes every name: a newline would make rows, U+009B and U+202E change others."""
    odd = "/t\nFAKE  row\x9b2J\u202e"
    changed = [attrs.evolve(one, name=odd) for one in ROBOT.topics[:1]]
    changed += [attrs.evolve(one, name="/" + 3000 * "x") for one in ROBOT.topics[1:2]]
    node = attrs.evolve(ROBOT.nodes[0], name="/n\nFAKE")
    text = render(
        live(attrs.evolve(ROBOT, topics=tuple(changed), nodes=(node, *ROBOT.nodes[1:]))),
        "text",
        everything=True,
    )
    lines = click.unstyle(text).split("\n")
    assert all(line.isprintable() for line in lines)
    assert not [line for line in lines if line.startswith("FAKE")]
    assert r"/t\nFAKE  row\x9b2J\u202e" in text
    assert max(len(line) for line in lines if "[no-publisher]" not in line) < 1500

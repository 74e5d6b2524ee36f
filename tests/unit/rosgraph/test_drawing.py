"""What is drawn of a graph, in each form; the golden files are what users get.

`pytest tests/unit/rosgraph --update-golden` writes them anew: look at the SVG in a browser then.
"""

from __future__ import annotations

import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from itertools import pairwise
from pathlib import Path

import pytest

from rigel_k8s.cli.rosgraph import FORMS, render
from rigel_k8s.commands.rosgraph import picture_of
from rigel_k8s.rosgraph.drawing.columns import Shape
from rigel_k8s.rosgraph.drawing.layout import Layout, lay_out
from rigel_k8s.rosgraph.drawing.picture import make_picture
from rigel_k8s.rosgraph.drawing.svg import (
    HEAD,
    LANE_GAP,
    ends,
    measure,
    node_key,
    shape_box,
    shape_pill,
    shorten,
    topic_key,
    write_svg,
)
from rigel_k8s.rosgraph.types import RosGraph

from .graphs import ODD, ROBOT, live, make_random

GOLDEN = Path(__file__).parent / "golden"


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("name", ["robot", "odd"])
def test_each_form_is_as_its_golden_file(name: str, form: str, *, update_golden: bool) -> None:
    graph = live({"robot": ROBOT, "odd": ODD}[name])
    file = GOLDEN / f"{name}.{form}"
    text = render(graph, form, everything=False)
    if update_golden:
        file.write_text(text, encoding="utf-8")
    assert text == file.read_text(encoding="utf-8")


@pytest.mark.parametrize("graph", [ROBOT, ODD, RosGraph(), make_random(1)])
def test_an_svg_is_xml_and_asks_for_nothing(graph: RosGraph) -> None:
    """No script, no font, no picture of another place."""
    text = write_svg(picture_of(live(graph)))
    ElementTree.fromstring(text)
    assert "http" not in text.replace("http://www.w3.org/2000/svg", "")
    assert "<script" not in text


def test_the_same_graph_is_drawn_the_same_in_each_process() -> None:
    """Whatever order sets have in it."""
    code = (
        "from tests.unit.rosgraph.graphs import *\n"
        "from rigel_k8s.cli.rosgraph import render\n"
        "graph = live(make_random(2))\n"
        "print(*(render(graph, f, everything=True) for f in ('svg', 'dot', 'mermaid')))"
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
    assert "/plan (action)" in write_svg(shown)
    everything = picture_of(live(ROBOT), everything=True)
    assert len(everything.pills) == len(ROBOT.topics)
    assert len(everything.boxes) == len(ROBOT.nodes)


def test_an_endpoint_of_a_node_that_has_just_left_is_drawn() -> None:
    """The graph is read while it changes."""
    gone = RosGraph(topics=ROBOT.topics[:1])
    assert {box.name for box in make_picture(gone).boxes} == {"/base", "/controller"}


def test_json_has_everything() -> None:
    told = json.loads(render(live(ROBOT), "json", everything=False))
    assert (told["release"], told["namespace"], told["ok"]) == ("explorer", "robots", False)
    assert [len(told[part]) for part in ("nodes", "topics", "services")] == [7, 7, 1]
    assert {problem["kind"] for problem in told["problems"]} == {
        "missing",
        "no-answer",
        "no-publisher",
        "type",
    }


def laid_out(graph: RosGraph) -> tuple[dict[str, Shape], Layout, list[tuple[str, str]]]:
    picture = make_picture(graph)
    groups = {title: number for number, title in enumerate(picture.groups)}
    shapes = {node_key(b.name): shape_box(b, groups[b.group]) for b in picture.boxes}
    shapes |= {topic_key(p.name): shape_pill(p, groups[p.group]) for p in picture.pills}
    edges = [ends(arrow) for arrow in picture.arrows]
    return shapes, lay_out(shapes, edges, head=HEAD, lane_gap=LANE_GAP), edges


SEEDS = [(1, 5, 2), (2, 12, 3), (3, 60, 5), (4, 60, 1), (5, 120, 20)]


@pytest.mark.parametrize(("seed", "nodes", "machines"), SEEDS)
def test_nothing_overlaps(seed: int, nodes: int, machines: int) -> None:
    """No box lies on another, nor outside of its machine's lane."""
    shapes, made, _ = laid_out(make_random(seed, nodes, machines))
    places = [(made.centres[name], shape) for name, shape in shapes.items()]
    for number, ((x, y), shape) in enumerate(places):
        lane = made.lanes[shape.group]
        assert lane.top + HEAD <= y - shape.height / 2 + 0.01
        assert y + shape.height / 2 <= lane.bottom
        assert x - shape.width / 2 >= -0.01
        assert x + shape.width / 2 <= made.width + 0.01
        for (other_x, other_y), other in places[number + 1 :]:
            apart = abs(x - other_x) >= (shape.width + other.width) / 2
            assert apart or abs(y - other_y) >= (shape.height + other.height) / 2 + 8
    for lane, below in pairwise(made.lanes):
        assert lane.bottom < below.top


@pytest.mark.parametrize(("seed", "nodes", "machines"), SEEDS)
def test_arrows_go_round_boxes(seed: int, nodes: int, machines: int) -> None:
    """An arrow begins and ends at its boxes, and its level parts lie in no other one."""
    shapes, made, edges = laid_out(make_random(seed, nodes, machines))
    for (start, end), points in zip(edges, made.routes, strict=True):
        for name, (x, y) in ((start, points[0]), (end, points[-1])):
            centre_x, centre_y = made.centres[name]
            assert abs(abs(x - centre_x) - shapes[name].width / 2) < 0.01
            assert abs(y - centre_y) < shapes[name].height / 2
        for (x, y), (next_x, next_y) in pairwise(points):
            left, right = min(x, next_x) + 0.01, max(x, next_x) - 0.01
            for name, (centre_x, centre_y) in made.centres.items():
                shape = shapes[name]
                beside = right <= centre_x - shape.width / 2 or left >= centre_x + shape.width / 2
                above = abs(y - centre_y) > shape.height / 2
                assert beside or above or name in (start, end), (start, end, name)
                assert beside or y == next_y or name in (start, end)


def test_texts_have_room_for_the_widest_font() -> None:
    """DejaVu Sans, the widest of the usual ones, needs this much at 13 px."""
    assert measure("/odometry/filtered", 13.0) > 121
    assert measure("sensor_msgs/msg/PointCloud2", 11.0) > 166
    assert len(shorten("/a" * 100)) <= 46
    assert shorten("/a" * 100).endswith("/a")

"""The diagrams of the documentation are those that tools/diagrams describes."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree

import pytest

from tools.diagrams.__main__ import FOLDER
from tools.diagrams.pictures import PICTURES
from tools.diagrams.scene import Box, Scene

#: Of a real release (tools/screenshots.py).
SCREENSHOTS = {"ui-light.png", "ui-dark.png"}
GRAPH = "graph.svg"  # by Graphviz, of tests/unit/rosgraph/golden/robot.dot


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_is_up_to_date(name: str) -> None:
    """Otherwise run `python -m tools.diagrams`."""
    text = (FOLDER / f"{name}.svg").read_text("utf-8")
    assert text == PICTURES[name].draw()
    assert ElementTree.fromstring(text).tag.endswith("svg")


def test_every_picture_is_used() -> None:
    """Some page shows each file of the folder, and each file has its description."""
    pages = "".join(page.read_text("utf-8") for page in FOLDER.parent.rglob("*.md"))
    files = {file.name for file in FOLDER.iterdir()}
    assert files == {f"{name}.svg" for name in PICTURES} | SCREENSHOTS | {GRAPH}
    links = set(re.findall(r"pictures/([\w.-]+)(?:#only-\w+)?\)", pages))
    assert files - links == set()


@pytest.mark.parametrize("name", [name for name, one in PICTURES.items() if isinstance(one, Scene)])
def test_a_scene_stays_in_its_frame(name: str) -> None:
    """Nothing is cut off at the right or at the bottom."""
    scene = PICTURES[name]
    assert isinstance(scene, Scene)
    for item in scene.items:
        if isinstance(item, Box):
            assert item.x + item.width <= scene.width, item
            assert item.y + item.height <= scene.height, item

"""Stacks of the size and shape of Muto's own samples pass check and render.

NOT_CARRIED is what they lose: the goal is an empty table.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest

from rigel_muto import convert as muto
from rigel_muto.opening import open_stack
from rigel_muto.options import Muto
from rigel_muto.remarks import Remark
from rigel_muto.translation import translate

from .shapes import FOLDER
from .test_option import objects_of

CARS = FOLDER / "cars"
#: The pods of each stack, with those of the stacks that it refers to.
PODS = {
    "buggy": 21,  # 24 nodes: drivers, transforms; a manager and its three nodelets share a pod
    "arena": 9,  # a simulator, most of whose nodes read one parameter file of the image
    "arena-gap": 10,  # that one, and a node more
    "arena-planner": 11,  # that one, two nodes more, and another configuration of rviz
    "testcar": 18,  # 21 nodes, some in a namespace that has parameters and a nodelet manager
    "convoy": 7,  # three references
    "camera": 1,  # ROS 2: a container with two components
}
#: "NODE: KEY" of what is not carried over; a key of the whole stack has no node.
NOT_CARRIED: Mapping[str, list[str]] = {
    "buggy": ["respawn"],
    "arena": [],
    "arena-gap": [],
    "arena-planner": ["move_base: ns"] * 2,
    "testcar": [],
    "convoy": [],
    "camera": [],
}


def describe(remark: Remark) -> str:
    """Return the node and the key in the stack's text; an entry of a list is called by the list."""
    span, source = remark.finding.span, remark.finding.source
    assert source is not None
    key = source.lines[span.line - 1][span.column - 1 : span.end_column - 1].strip('"')
    key = "param" if key.startswith("{") else key
    return f"{remark.node}: {key}" if remark.node else key


@pytest.mark.parametrize("name", PODS)
def test_the_table_has_what_is_not_carried_over(name: str) -> None:
    """Each loss is a warning with the node and key that it is about."""
    stack, find = open_stack(f"{name}.json", CARS, CARS, None)
    made = translate(stack, {}, find)
    assert len(made.nodes) == PODS[name]
    lost = [describe(remark) for remark in made.remarks if remark.lost]
    assert sorted(lost) == sorted(NOT_CARRIED[name])


@pytest.mark.parametrize("name", PODS)
def test_check_and_render_know_each_pod(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The converted Rigelfile and `muto: STACK` deploy the same, and both pass `rigel check`."""
    files = tmp_path / "cars"
    shutil.copytree(CARS, files)
    monkeypatch.chdir(files)
    text = muto.convert(Muto(stack=f"{name}.json"), "robot:1").text
    converted, option = files / "Rigelfile.converted", files / "Rigelfile"
    converted.write_text(text)
    option.write_text(text.partition("      nodes:\n")[0] + f"      muto: {name}.json\n")
    objects = objects_of(converted)
    deployments = [item["metadata"]["name"] for item in objects if item["kind"] == "Deployment"]
    others = ("ros-master", "-global-parameters")
    assert len([each for each in deployments if not each.endswith(others)]) == PODS[name]
    assert objects == objects_of(option)

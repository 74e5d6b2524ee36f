"""The fleet of docs/fleet.md passes the check, and becomes a release of its own for each robot."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from tests.support.tutorials import RIGEL, make_place, run

from .test_whole_robot import DOCS, find, read_files, read_pod

pytestmark = pytest.mark.programs

PAGE = (DOCS / "fleet.md").read_text("utf-8")
(RIGELFILE,) = read_files(PAGE).values()
(CAREFUL,) = re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.M | re.S)
ROBOTS = [f"robot-0{number}" for number in range(1, 6)]
REGISTRY = "registry.example"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """The page's Rigelfile, with a registry that refuses connections at once."""
    found = make_place(tmp_path, {"rigel": RIGEL})
    (found / "Rigelfile").write_text(RIGELFILE.replace(REGISTRY, "127.0.0.1:9"))
    return found


def test_its_rigelfile_has_no_problems(place: Path) -> None:
    """Also with one robot before the others."""
    assert run("rigel check", place).stdout == "Rigelfile: no problems\n"
    jobs = (place / "Rigelfile").read_text().partition("\nsequences:")[0]
    (place / "Rigelfile").write_text(f"{jobs}\n{CAREFUL}")
    assert run("rigel check", place).stdout == "Rigelfile: no problems\n"


def test_each_robot_is_in_every_list_of_the_page() -> None:
    """In both matrices, and in the loops over namespaces."""
    matrix = yaml.safe_load(RIGELFILE)["sequences"]["fleet"]["stages"][0]["matrix"]
    stages = yaml.safe_load(CAREFUL)["sequences"]["fleet"]["stages"]
    loops = re.findall(r"for robot in (.*?); do", PAGE, re.M)
    assert matrix["robot"] == ROBOTS
    assert [robot for stage in stages for robot in stage["matrix"]["robot"]] == ROBOTS
    assert [loop.split() for loop in loops] == [ROBOTS, ROBOTS]


def test_what_one_robot_gets_is_its_own(place: Path) -> None:
    """Namespace, machines and volume have its name; the page counts what `down` deletes."""
    done = run("KUBECONFIG=none rigel -q render deploy --data robot=robot-02 2>problems", place)
    assert done.returncode == 0, (place / "problems").read_text()
    objects = list(yaml.safe_load_all(done.stdout))
    kinds = [item["kind"] for item in objects]
    assert find(objects, "PersistentVolume", "bags-robot-02-pv")
    assert {item["metadata"].get("namespace") for item in objects} == {"robot-02", None}
    for name in ("ros-master", "planner", "base", "recorder"):
        assert read_pod(objects, name)["nodeSelector"] == {"kubernetes.io/hostname": "robot-02"}
    kept = sum(kind.startswith("PersistentVolume") for kind in kinds)
    assert f"{len(kinds) - kept} objects deleted, {kept} kept for its data" in PAGE

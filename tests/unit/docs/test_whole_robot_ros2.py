"""The ROS 2 robot of docs/whole-robot.md passes the check and becomes what the page says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.tutorials import run

from .test_whole_robot import DOCS, find, lay_out, read_files, read_pod, read_section, render

pytestmark = pytest.mark.programs

PAGE = read_section("A ROS 2 robot")
FILES = read_files(PAGE)
MACHINES = {
    "planner": "robot-1",
    "camera": "robot-1",
    "recorder": "robot-1",
    "navigation": "server",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's files."""
    return lay_out(FILES, tmp_path_factory.mktemp("reader"))


@pytest.fixture(scope="module")
def objects(place: Path) -> list[Any]:
    """What its deploy makes."""
    return render(place)


def test_the_page_has_all_files_that_it_lists() -> None:
    """Except for the sources of the planner and the parameters of nav2."""
    assert set(FILES) == {
        "Rigelfile",
        "workspace/config/planner.yaml",
        "camera/Dockerfile",
        "navigation/Dockerfile",
    }


def test_its_rigelfile_has_no_problems(place: Path) -> None:
    """Also with the token that the page exports."""
    done = run("export GHCR_TOKEN=x; rigel check", place)
    assert (done.returncode, done.stdout) == (0, "Rigelfile: no problems\n")


def test_nodes_are_updated_as_its_table_says(objects: list[Any]) -> None:
    """What can run twice hands over, and no other node is in the table."""
    shown = dict(re.findall(r"^\| `(\w+)` \| `(\w+)` \|", PAGE, re.M))
    assert set(shown) == set(MACHINES)
    for name, way in shown.items():
        deployment = find(objects, "Deployment", name)
        annotated = deployment["metadata"]["annotations"].get("rigel-k8s/update", "Recreate")
        kind = "RollingUpdate" if way == "HandOver" else way
        assert deployment["spec"]["strategy"]["type"] == kind
        assert annotated.partition(":")[0] == way


def test_a_new_build_of_the_workspace_changes_the_planner_alone(
    objects: list[Any], tmp_path: Path
) -> None:
    """No other node and no discovery server has its image."""
    text = FILES["Rigelfile"].replace('version: "1.0"', 'version: "1.1"')
    after = render(lay_out({**FILES, "Rigelfile": text}, tmp_path))
    changed = [
        (new["kind"], new["metadata"]["name"])
        for old, new in zip(objects, after, strict=True)
        if old != new
    ]
    assert changed == [("Deployment", "planner")]


def test_every_node_is_on_its_machine_and_asks_both_servers(objects: list[Any]) -> None:
    """No node is on the machine's own network."""
    servers = ";".join(f"rigel-k8s-application-discovery-{index}:11811" for index in range(2))
    for name, machine in MACHINES.items():
        pod = read_pod(objects, name)
        env = {item["name"]: item.get("value") for item in pod["containers"][0]["env"]}
        assert pod["nodeSelector"] == {"kubernetes.io/hostname": machine}
        assert env["ROS_DISCOVERY_SERVER"] == servers
        assert "hostNetwork" not in pod
        assert ("ROS_SUPER_CLIENT" in env) is (name == "recorder")
    for index in range(2):
        assert find(objects, "Service", f"rigel-k8s-application-discovery-{index}")


def test_the_recorder_has_no_name_that_no_node_has(objects: list[Any]) -> None:
    """`ros2 bag` names its node."""
    assert (
        "rigel-k8s/ros-name"
        not in find(objects, "Deployment", "recorder")["metadata"]["annotations"]
    )
    volume = find(objects, "PersistentVolume", "bags-pv")
    assert volume["spec"]["hostPath"]["path"] == "/var/lib/bags"


def test_the_planner_gets_its_parameter_file(objects: list[Any]) -> None:
    """For any node of its process."""
    (text,) = find(objects, "ConfigMap", "planner-parameters")["data"].values()
    found = yaml.safe_load(text)
    assert found == {"/**": {"ros__parameters": {"rate": 10, "frame": "base_link"}}}


def test_foxglove_is_one_more_line_of_the_robot(tmp_path: Path) -> None:
    """The line of "See your robot" passes the check among the others."""
    page = (DOCS / "whole-robot.md").read_text("utf-8")
    (line,) = re.findall(r"^```yaml\n(foxglove: .*)\n```$", page, re.M)
    head, nodes, rest = FILES["Rigelfile"].partition("      nodes:\n")
    changed = lay_out({**FILES, "Rigelfile": f"{head}      {line}\n{nodes}{rest}"}, tmp_path)
    done = run("export GHCR_TOKEN=x; rigel check", changed)
    assert (done.returncode, done.stdout) == (0, "Rigelfile: no problems\n")

"""The ROS 1 robot of docs/whole-robot.md passes the check and becomes what the page says."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.support.tutorials import RIGEL, make_place, run

DOCS = Path(__file__).parents[3] / "docs"
NODES = ("planner", "camera", "recorder")


def read_files(page: str) -> dict[str, str]:
    """Return the files that a page shows, by their paths."""
    return dict(re.findall(r'^```\w+ title="([^"\n]+)"\n(.*?)^```$', page, re.M | re.S))


def read_section(title: str) -> str:
    """Return what the page shows of one robot."""
    page = (DOCS / "whole-robot.md").read_text("utf-8")
    return page.partition(f"\n## {title}\n")[2].partition("\n## ")[0]


def lay_out(files: dict[str, str], directory: Path) -> Path:
    """Write a page's files; its registries are one that refuses connections at once."""
    found = make_place(directory, {"rigel": RIGEL})
    (found / "workspace/src/planner").mkdir(parents=True)
    (found / "workspace/src/planner/package.xml").write_text("<package/>\n")
    for name, text in files.items():
        (found / name).parent.mkdir(parents=True, exist_ok=True)
        here = text.replace("ghcr.io", "127.0.0.1:9").replace(
            "image: ros:", "image: 127.0.0.1:9/ros:"
        )
        (found / name).write_text(here)
    return found


def render(place: Path) -> list[Any]:
    """Return what the deploy of a page's Rigelfile makes."""
    done = run("export GHCR_TOKEN=x KUBECONFIG=none; rigel -q render deploy 2>problems", place)
    assert done.returncode == 0, (place / "problems").read_text()
    return list(yaml.safe_load_all(done.stdout))


PAGE = read_section("A ROS 1 robot")
FILES = read_files(PAGE)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's files."""
    return lay_out(FILES, tmp_path_factory.mktemp("reader"))


@pytest.fixture(scope="module")
def objects(place: Path) -> list[Any]:
    """What its deploy makes."""
    return render(place)


def find(objects: list[Any], kind: str, name: str) -> Any:
    """Return one object."""
    (found,) = (o for o in objects if (o["kind"], o["metadata"]["name"]) == (kind, name))
    return found


def read_pod(objects: list[Any], node: str) -> Any:
    """Return the spec of a node's pods."""
    return find(objects, "Deployment", node)["spec"]["template"]["spec"]


def test_the_page_has_all_files_that_it_lists() -> None:
    """Except for the sources of the planner."""
    assert set(FILES) == {"Rigelfile", "workspace/config/planner.yaml", "camera/Dockerfile"}


@pytest.mark.programs
def test_its_rigelfile_has_no_problems(place: Path) -> None:
    """Also with the token that the page exports."""
    done = run("export GHCR_TOKEN=x; rigel check", place)
    assert (done.returncode, done.stdout) == (0, "Rigelfile: no problems\n")


@pytest.mark.programs
def test_its_token_must_be_set_also_where_no_registry_is_asked(place: Path) -> None:
    """As docs/cli.md says of providers' variables; `objects` shows that any value will do."""
    done = run("unset GHCR_TOKEN; rigel render deploy 2>&1", place)
    assert done.returncode == 2
    assert "vars.GHCR_TOKEN is neither in vars nor in the environment" in done.stdout


@pytest.mark.programs
def test_nodes_are_updated_as_its_table_says(objects: list[Any]) -> None:
    """And no other node is in the table."""
    table = re.findall(r"^\| `(\w+)` \| `(\w+)` \| ?(.*?) ?\|$", PAGE, re.M)
    shown = {name: f"{way}: {why}" if why else way for name, way, why in table}
    nodes = {
        item["metadata"]["name"]: item["metadata"]["annotations"].get("rigel-k8s/update")
        for item in objects
        if item["kind"] == "Deployment" and item["metadata"]["name"] != "ros-master"
    }
    assert nodes == shown
    assert len(shown) == 3


@pytest.mark.programs
def test_the_command_before_the_table_prints_each_node_with_its_update(place: Path) -> None:
    """A line for the name, and the next one for the update, in the order of the table."""
    (command,) = re.findall(r"^`(rigel render deploy \| grep [^`]*)`", PAGE, re.M)
    done = run(f"export GHCR_TOKEN=x KUBECONFIG=none; {command}", place)
    lines = [line.strip().removeprefix("rigel-k8s/") for line in done.stdout.splitlines()]
    assert lines[::2] == [f"node: {name}" for name in NODES]
    assert [line.split()[:2] for line in lines[1::2]] == [
        ["update:", "HandOver"],
        ["update:", "'Recreate:"],
        ["update:", "'Recreate:"],
    ]


def test_a_new_build_of_the_workspace_leaves_the_camera_alone(objects: list[Any]) -> None:
    """It has an image of its own, the others share one."""
    image = {name: read_pod(objects, name)["containers"][0]["image"] for name in NODES}
    assert image["planner"] == image["recorder"] != image["camera"]


def test_the_planner_gets_its_parameter_file(objects: list[Any]) -> None:
    """Below its own ROS name."""
    (text,) = find(objects, "ConfigMap", "planner-parameters")["data"].values()
    assert yaml.safe_load(text) == {"rate": 10, "frame": "base_link"}
    (container,) = read_pod(objects, "planner")["containers"]
    assert "/planner" in container["args"]


def test_roscore_stays_on_the_robot(objects: list[Any]) -> None:
    """Its pod is not evicted from there, and keeps its address while the machine is cut off."""
    pod = read_pod(objects, "ros-master")
    assert pod["nodeSelector"] == {"kubernetes.io/hostname": "robot-1"}
    assert [one.get("tolerationSeconds", "for ever") for one in pod["tolerations"]] == [
        "for ever",
        "for ever",
    ]
    assert find(objects, "Service", "ros-master")["spec"]["publishNotReadyAddresses"] is True


def test_camera_and_recorder_stay_on_the_robot(objects: list[Any]) -> None:
    """Where the device and the bags are."""
    for name in ("camera", "recorder"):
        assert read_pod(objects, name)["nodeSelector"] == {"kubernetes.io/hostname": "robot-1"}
    volume = find(objects, "PersistentVolume", "bags-pv")
    assert volume["spec"]["hostPath"]["path"] == "/var/lib/bags"

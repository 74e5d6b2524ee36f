"""Every shape of manifest has a golden file; a changed one restarts robots, so it must be seen."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.support.golden import Golden

from .shapes import GOLDEN, release

CASES = sorted(path.name.removesuffix(".with.yaml") for path in GOLDEN.glob("*.with.yaml"))
FILES = {
    "config/planner.yaml": "speed: 1\n",
    "config/common.yaml": "frame: map\n",
    "config/ros2.yaml": "/ns/listener:\n  ros__parameters:\n    queue: 1e3\n",
}
DIGEST = "sha256:" + "ab" * 32


def make(case: str) -> Iterable[Any]:
    """Return the objects of a case."""
    objects = release((GOLDEN / f"{case}.with.yaml").read_text("utf-8"), files=FILES).objects
    for item in copy.deepcopy(objects):
        if "interface.sh" in item.get("data", {}):
            item["data"]["interface.sh"] = "# in the golden files of tests/unit/network\n"
        yield item


FOLDER = Golden(GOLDEN, make, ("nodes", "ros2-nodes", "ros2-updates"), CASES)


@pytest.mark.parametrize("case", CASES)
def test_manifests_are_those_of_the_golden_file(case: str, *, update_golden: bool) -> None:
    """The same options give the same objects, to the last field."""
    FOLDER.compare(case, update=update_golden)


#: Containers that are no ROS program: exporter, gate, and what a Rigelfile brings itself.
NOT_ROS = ("ros-exporter", "gate", "sidecar", "mine", "global-parameters")


def ros_containers(case: str) -> list[dict[str, Any]]:
    """Return the containers that run ROS programs, discovery servers and routers too."""
    made = release((GOLDEN / f"{case}.with.yaml").read_text("utf-8"), files=FILES)
    pods = [
        item["spec"]["template"]["spec"] for item in made.objects if "Deployment" in item["kind"]
    ]
    found = [container for pod in pods for container in pod["containers"]]
    return [container for container in found if container["name"] not in NOT_ROS]


@pytest.mark.parametrize("case", CASES)
def test_every_ros_container_is_asked_to_stop(case: str) -> None:
    """Many ROS programs ignore SIGTERM: without the hook each update takes the whole grace."""
    found = ros_containers(case)
    assert found or case == "foreign-container"
    for container in found:
        hook = container["lifecycle"]["preStop"]["exec"]["command"]
        assert hook[:2] == ["/bin/sh", "/rigel-k8s/stop.sh"], container["name"]


def test_building_leaves_the_options_alone() -> None:
    """Twice the same options are twice the same objects: nothing is changed in passing."""
    text = (GOLDEN / "src-plugin.with.yaml").read_text("utf-8")
    first = release(text, digests={"registry.example:5000/turtle:1.0": "x@" + DIGEST})
    again = copy.deepcopy(first.objects)
    assert (
        release(text, digests={"registry.example:5000/turtle:1.0": "x@" + DIGEST}).objects == again
    )
    assert first.objects == again


def test_golden_files_have_their_options() -> None:
    """No golden file outlives its case."""
    golden = {path.stem for path in Path(GOLDEN).glob("*.yaml") if ".with" not in path.name}
    assert golden == set(CASES)

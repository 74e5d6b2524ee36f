"""A fleet of robots, each a namespace of a real cluster, deployed in waves by one sequence."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef

pytestmark = pytest.mark.cluster

#: The second robot's image does not exist, and its registry answers only on a robot, if at all.
MISSING = "localhost:1/rigel-k8s/missing:1"
ROBOTS = ("first", "broken", "third", "fourth", "fifth")


@pytest.fixture
def robots(admin: Any, namespace: str) -> Iterator[list[str]]:
    """Names of robots, whose namespaces are deleted after the test."""
    names = [f"{namespace}-{robot}" for robot in ROBOTS]
    yield names
    for name in names:
        admin.delete(ObjectRef("v1", "Namespace", "", name))


def write(directory: Path, registry: str, robots: list[str]) -> None:
    """Write a Rigelfile that deploys to two robots at once and stops after a failure."""
    good = f"{registry}/rigel-k8s/pause:1"
    image = f"{{{{ '{MISSING}' if 'broken' in data.robot else '{good}' }}}}"
    node = {"image": image, "command": ["/catatonit", "-P"], "readiness": "none", "parameters": {}}
    deploy = {
        "namespace": "{{ data.robot }}",
        "deploy_ros_master": False,
        "ros_master_uri": "http://robot:11311",
        "nodes": {"idle": node},
    }
    limits = {"max_parallel": [2], "stop_after_failures": [1]}
    stage = {"parallel": [{"jobs": ["deploy"]}], "matrix": {"robot": robots, **limits}}
    rigelfile = {
        "application": {"distro": "noetic"},
        "jobs": {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": deploy}},
        "sequences": {"fleet": {"stages": [stage]}},
    }
    (directory / "Rigelfile").write_text(json.dumps(rigelfile))


def test_a_robot_that_fails_ends_its_wave_and_no_other_begins(
    rigel: Callable[..., subprocess.CompletedProcess[str]],
    cluster: Any,
    registry: str,
    robots: list[str],
    tmp_path: Path,
) -> None:
    """The robot beside it is deployed to its end, the later ones are left alone; all are listed.

    Then all of the fleet's releases end by one command.
    """
    write(tmp_path, registry, robots)
    done = rigel("run", "sequence", "fleet", cwd=tmp_path, check=False)
    assert done.returncode == 1
    first, broken, *later = robots
    assert "1 of 5 branches failed" in done.stderr
    assert f"  done: robot={first}\n" in done.stderr
    assert f"  not begun: {'; '.join(f'robot={name}' for name in later)}\n" in done.stderr
    assert f"failed: job deploy (robot={broken})" in done.stderr
    assert f"image {MISSING} cannot be pulled" in done.stderr
    assert cluster.get(ObjectRef("apps/v1", "Deployment", first, "idle")) is not None
    assert cluster.get(ObjectRef("apps/v1", "Deployment", broken, "idle")) is not None
    for left in later:
        assert cluster.get(ObjectRef("v1", "Namespace", "", left)) is None
    ended = rigel("down", "--sequence", "fleet", cwd=tmp_path).stdout
    assert f"removed rigel-k8s-application from {first}: " in ended
    assert f"removed rigel-k8s-application from {broken}: " in ended
    assert f"there is no release rigel-k8s-application in the namespace {later[0]}\n" in ended
    for robot in (first, broken):
        assert cluster.list("v1", "Pod", robot) == []
        assert cluster.list("v1", "Secret", robot) == []

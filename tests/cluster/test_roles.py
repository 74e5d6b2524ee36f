"""The Roles that `rigel rbac` prints: what a deployer and a viewer can do with them alone."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.support.until import until

from .background import Background
from .rights import grant_role, write_impersonation
from .robot import Robot

pytestmark = pytest.mark.cluster

VIEWER = "rigel-test-viewer"
TALKER = (
    "import os, rospy, std_msgs.msg as m; rospy.init_node('talker');"
    " p = rospy.Publisher('chatter', m.String, queue_size=1); r = rospy.Rate(5)\n"
    "while not rospy.is_shutdown(): rospy.loginfo('hello'); p.publish('hello'); r.sleep()"
)


@pytest.fixture
def robot(
    tmp_path: Path, namespace: str, base_image: str, rigel_as_deployer: Any, cluster: Any
) -> Robot:
    """A robot whose `rigel` is a deployer's."""
    return Robot(tmp_path, namespace, base_image, rigel_as_deployer, cluster)


@pytest.fixture
def view(robot: Robot, admin: Any, rigel: Any, context: str, tmp_path: Path) -> Callable[..., Any]:
    """Run `rigel` on the robot as a viewer."""
    grant_role(admin, robot.namespace, "viewer", VIEWER)
    file = write_impersonation(context, VIEWER, tmp_path)
    place = ("-f", str(robot.file), "-n", robot.namespace, "--kubeconfig", str(file))
    return lambda *words: rigel(*place, *words, check=False)


def write(robot: Robot, version: str) -> None:
    """Write a Rigelfile with what needs rights of its own: a gate, a claim, a policy."""
    robot.write(
        {
            "talker": {
                "args": ["python3", "-c", TALKER],
                "env": {"VERSION": version},
                "volumes": [{"name": "maps", "mount_path": "/maps"}],
            }
        },
        network_policy=True,
        persistent_storage={"volumes": [{"name": "maps", "size": "10Mi"}]},
    )


def test_a_deployer_does_it_all_and_a_viewer_looks(
    robot: Robot, view: Callable[..., Any], context: str, deployer_config: Path
) -> None:
    """From the first deploy to the end of the volumes; the viewer changes nothing."""
    write(robot, "1")
    robot.deploy()
    write(robot, "2")
    assert "VERSION" in robot.rigel("diff").stdout
    robot.deploy()
    robot.rigel("rollback")
    assert "VERSION" in robot.rigel("diff").stdout, "the first version runs again"
    look_as_deployer(robot)
    assert forwards(robot, context, deployer_config)
    look_as_viewer(robot, view)
    refuse_viewer(view)
    robot.rigel("down")
    robot.rigel("down", "--volumes", "-y")
    assert robot.deployments() == set()
    assert robot.cluster.list("v1", "PersistentVolumeClaim", robot.namespace) == []


def look_as_deployer(robot: Robot) -> None:
    """Run each command that looks."""
    for words, answer in (
        ("status", "revision 3"),
        ("graph", "/chatter"),
        ("logs talker", "hello"),
        ("history", "rollback to revision 1"),
        ("list", "good"),
        ("exec talker rosnode list", "/talker"),
        ("doctor", "all that ROS 1's gate needs"),
    ):
        until(partial(is_told, robot, words, answer), f"{answer} in `rigel {words}`", 180)


def is_told(robot: Robot, words: str, answer: str) -> bool:
    """Return whether a command says this; a node is ready before it has its topics and logs."""
    done = robot.rigel(*words.split(), check=False)
    return done.returncode == 0 and answer in done.stdout


def forwards(robot: Robot, context: str, config: Path) -> bool:
    """Return whether a forwarded port is open: it is the gate's, and answers to HTTP."""
    place = ("-f", str(robot.file), "--kubeconfig", str(config), "--context", context)
    words = (*place, "-n", robot.namespace, "forward", "ros-master", ":11311")
    with Background([sys.executable, "-m", "rigel_k8s", *words]) as running:

        def answers() -> bool:
            door = running.found(r"127\.0\.0\.1:(\d+) -> ")
            if not door:
                return False
            try:
                with socket.create_connection(("127.0.0.1", int(door[1])), 30) as there:
                    there.sendall(b"GET / HTTP/1.0\r\n\r\n")
                    return there.recv(4) == b"HTTP"
            except OSError:
                return False

        return bool(until(answers, "an answer through the forwarded port", 180))


def look_as_viewer(robot: Robot, view: Callable[..., Any]) -> None:
    """See what runs and what it writes; what takes more says which right."""
    seen = view("status")
    assert "talker" in seen.stdout
    assert "its revision cannot be read (the right to list secrets is missing)" in seen.stdout
    assert "(the right `create pods/exec` is missing)" in seen.stdout + seen.stderr
    for name in ((), ("rigel-k8s-application",)):  # the job's, and the release's
        looked = view("status", "--no-graph", *name)
        assert (looked.returncode, "talker" in looked.stdout) == (0, True), looked.stderr
    assert "hello" in view("logs", "talker").stdout
    for words in ("history", "list", "diff"):
        refused = view(words)
        assert refused.returncode == 1
        assert "Secret" in refused.stderr, refused.stderr
    refused = view("graph")
    assert (refused.returncode, "create pods/exec" in refused.stderr) == (1, True)
    assert "Traceback" not in refused.stderr


def refuse_viewer(view: Callable[..., Any]) -> None:
    """Nothing can be changed, and no command runs in a pod."""
    deploy = view("run", "job", "deploy")
    assert deploy.returncode == 1
    assert "deployments.apps: create, patch" in deploy.stderr
    for words in ("down", "rollback", "exec talker true"):
        assert view(*words.split()).returncode == 1

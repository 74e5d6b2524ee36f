"""A stack of Eclipse Muto on a real cluster: each node is a pod, and remappings are kept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from .robot import Robot

pytestmark = pytest.mark.cluster

#: What Muto's launcher does with it: both nodes in one container, and no remapping.
STACK = {
    "name": "Talker and listener",
    "stackId": "org.example.robots:talker-listener",
    "arg": [
        {"name": "robot", "value": "robot0"},
        {"name": "topic", "value": "/$(arg robot)/chatter"},
    ],
    "node": [
        {
            "name": "talker",
            "pkg": "topic_tools",
            "exec": "relay",
            "args": "/source chatter",
            "output": "screen",
            "param": [{"name": "rate", "value": "2"}],
            "remap": [{"from": "chatter", "to": "$(arg topic)"}],
        },
        {
            "name": "listener",
            "namespace": "$(arg robot)",
            "pkg": "topic_tools",
            "exec": "relay",
            "args": "chatter heard",
        },
    ],
}
#: A node of the Rigelfile beside those of the stack.
SOURCE = {"args": ["rostopic", "pub", "-r", "5", "/source", "std_msgs/String", "hello"]}


@pytest.fixture
def robot(tmp_path: Path, namespace: str, base_image: str, rigel: Any, cluster: Any) -> Robot:
    """A robot in a namespace of its own."""
    return Robot(tmp_path, namespace, base_image, rigel, cluster)


def test_messages_go_through_the_nodes_of_a_stack(robot: Robot) -> None:
    """From a node of the Rigelfile by the remapped topic into the other node's namespace."""
    (robot.file.parent / "stack.json").write_text(json.dumps(STACK))
    muto = {"stack": "stack.json", "args": {"robot": "robot1"}}
    robot.write({"source": SOURCE}, muto=muto)
    robot.deploy()
    names = {"ros-master", "source", "talker", "robot1-listener"}
    assert robot.deployments() == names
    heard = ("timeout", "60", "rostopic", "echo", "-n", "1", "/robot1/heard/data")
    assert "hello" in robot.run("robot1-listener", *heard)
    assert robot.run("talker", "rosparam", "get", "/talker/rate").strip() == "2"
    assert robot.rigel("diff", "--exit-code").returncode == 0

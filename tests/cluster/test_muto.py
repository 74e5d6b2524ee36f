"""A stack of Eclipse Muto on a real cluster: each node is a pod, and remappings are kept."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

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
    "param": [
        {"name": "greeting", "namespace": "source", "value": "$(optenv GREETING hello)"},
        {"name": "description", "command": "cat $(find topic_tools)/package.xml"},
    ],
    "node": [
        {
            "name": "talker",
            "pkg": "topic_tools",
            "exec": "relay",
            "args": "/source/words chatter _home:=$(find topic_tools)",
            "output": "screen",
            "param": [
                {"name": "rate", "value": "2"},
                {"from": "$(find topic_tools)/config/relay.yaml", "namespace": "queue"},
                {"name": "version", "command": "rosversion topic_tools"},
            ],
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
#: A node of the Rigelfile beside those of the stack, which ends without the stack's parameter.
TALK = """
import rospy, std_msgs.msg
rospy.init_node("source")
text = rospy.get_param("/source/greeting")
publisher = rospy.Publisher("/source/words", std_msgs.msg.String, queue_size=1)
while not rospy.is_shutdown():
    publisher.publish(text)
    rospy.sleep(0.2)
"""
SOURCE = {"args": ["python3", "-c", TALK]}


@pytest.fixture
def robot(tmp_path: Path, namespace: str, base_image: str, rigel: Any, cluster: Any) -> Robot:
    """A robot in a namespace of its own."""
    return Robot(tmp_path, namespace, base_image, rigel, cluster)


@pytest.fixture
def config(cluster: Any, namespace: str) -> dict[str, Any]:
    """A mount with a parameter file, which stands for a directory of the image."""
    made = {
        "apiVersion": "v1",
        "kind": "ConfigMap",
        "metadata": {"name": "config", "namespace": namespace},
        "data": {"relay.yaml": "size: 5\n"},
    }
    cluster.create(made)
    return {"config_map": "config", "mount_path": "/usr/share/topic_tools/config"}


def test_messages_go_through_the_nodes_of_a_stack(robot: Robot, config: dict[str, Any]) -> None:
    """From a node of the Rigelfile by the remapped topic into the other node's namespace.

    What only the image knows is there: for the nodes, and for the parameters of the whole stack.
    """
    (robot.file.parent / "stack.json").write_text(json.dumps(STACK))
    muto = {"stack": "stack.json", "args": {"robot": "robot1"}, "strict": True}
    robot.write({"source": SOURCE, "talker": {"volumes": [config]}}, muto=muto)
    robot.deploy()
    setter = "rigel-k8s-application-global-parameters"
    assert robot.deployments() == {"ros-master", setter, "source", "talker", "robot1-listener"}
    heard = ("timeout", "150", "rostopic", "echo", "-n", "1", "/robot1/heard/data")
    assert "hello" in robot.run("robot1-listener", *heard)
    assert yaml.safe_load(robot.run("talker", "rosparam", "get", "/talker")) == {
        "rate": 2,
        "home": "/opt/ros/noetic/share/topic_tools",
        "queue": {"size": 5},
        "version": robot.run("talker", "rosversion", "topic_tools"),
    }
    assert "<name>topic_tools</name>" in robot.run("talker", "rosparam", "get", "/description")
    assert robot.rigel("diff", "--exit-code").returncode == 0

"""`foxglove: true` on real ROS 2: a viewer gets a node's messages through `rigel forward`.

The bridge itself is in no registry that the test machines reach: bridge.py stands in for it.
"""

from __future__ import annotations

import json
import shutil
import struct
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import websocket

from tests.support.ros2base import push_ros2
from tests.support.until import until

from ..background import Background
from .conftest import Project

pytestmark = pytest.mark.cluster

TALKER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(String, "/chatter", 1)
node.create_timer(0.2, lambda: publisher.publish(String(data="hello")))
rclpy.spin(node)
"""
INSTALLED = "/opt/ros/jazzy"
PROTOCOL = "foxglove.sdk.v1"


@pytest.fixture
def robot(cluster: Any, context: str, namespace: str, registry: str, tmp_path: Path) -> Project:
    """A talker and the bridge; without `files` its image has no bridge."""
    image = f"{registry}/ros:jazzy"
    push_ros2(image)
    shutil.copy(Path(__file__).with_name("bridge.py"), tmp_path)
    (tmp_path / "bridge.py").chmod(0o755)
    (tmp_path / "empty").write_text("")
    files = {
        f"{INSTALLED}/lib/foxglove_bridge/foxglove_bridge": "bridge.py",
        f"{INSTALLED}/share/ament_index/resource_index/packages/foxglove_bridge": "empty",
    }
    options = {
        "image": image,
        "network": "peers",
        "foxglove": True,
        "nodes": {"talker": {"args": ["python3", "-c", TALKER]}, "foxglove": {"files": files}},
    }
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    file = tmp_path / "Rigelfile"
    file.write_text(json.dumps({"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}))
    return Project(cluster, context, namespace, file, {})


def test_a_viewer_sees_the_messages_of_a_node(robot: Project) -> None:
    """The bridge has its parameter and its name, and nothing but its name is needed to reach it."""
    robot("run", "job", "deploy")
    name = robot.pods()["foxglove"]["metadata"]["name"]
    lines = robot.cluster.logs(robot.space, name)
    assert any(line.endswith("[foxglove]: listens at 8765") for line in lines)
    with Background(robot.command("forward", "foxglove", ":8765")) as running:
        shown = until(lambda: running.found(r"ds\.url=(ws://127\.0\.0\.1:\d+)$"), "an address")
        with closing(websocket.create_connection(shown[1], 30, subprotocols=[PROTOCOL])) as viewer:
            assert json.loads(viewer.recv())["op"] == "serverInfo"
            (channel,) = json.loads(viewer.recv())["channels"]
            assert (channel["topic"], channel["schemaName"]) == ("/chatter", "std_msgs/msg/String")
            request = {"id": 7, "channelId": channel["id"]}
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": [request]}))
            message = viewer.recv()
    assert isinstance(message, bytes)
    assert struct.unpack_from("<BI", message) == (1, 7)
    assert b"hello\0" in message

"""Nodes that exchange messages are updated together, with peers: none waits for the other."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from ..conftest import Rigel

pytestmark = pytest.mark.cluster

DRIVER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("driver")
out = node.create_publisher(String, "scan", 10)
node.create_timer(0.05, lambda: out.publish(String()))
rclpy.spin(node)
"""
FILTER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("filter")
out = node.create_publisher(String, "clean", 10)
node.create_subscription(String, "scan", out.publish, 10)
rclpy.spin(node)
"""


def test_two_that_are_updated_together_take_over_soon(
    rigel_as_deployer: Rigel, namespace: str, ros2_image: str, tmp_path: Path
) -> None:
    """Each waits, and the other one's new version cannot be discovered yet."""
    rigel = rigel_as_deployer

    def deploy(version: str) -> None:
        more = {"env": {"VERSION": version}}
        nodes = {
            "driver": {"args": ["python3", "-c", DRIVER], **more},
            "filter": {"args": ["python3", "-c", FILTER], **more},
        }
        options = {"image": ros2_image, "namespace": namespace, "network": "peers", "nodes": nodes}
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
        (tmp_path / "Rigelfile").write_text(yaml.safe_dump(whole))
        rigel("run", "deploy", cwd=tmp_path)

    deploy("1")
    deploy("2")
    for node in ("driver", "filter"):
        log = rigel("logs", node, cwd=tmp_path).stdout
        assert "works, took over from" in log
        assert "did not find all" not in log

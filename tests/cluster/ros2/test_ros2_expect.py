"""What is expected of topics, with real nodes: compared, learned, and kept by an update."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

from ..conftest import Rigel

pytestmark = pytest.mark.cluster

TALKER = """
import rclpy, sys
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talker")
out = node.create_publisher(String, "chatter", 10)
node.create_timer(1 / float(sys.argv[1]), lambda: out.publish(String()))
rclpy.spin(node)
"""
LISTENER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(String, "chatter", lambda _: None, 10)
rclpy.spin(node)
"""
EXPECTED = {
    **{"type": "std_msgs/String", "rate": "5..", "gap": "20s", "age": "20s"},
    **{"publishers": 1, "subscribers": 1, "else": "rollback"},
}


def write(folder: Path, namespace: str, image: str, rate: int) -> None:
    """Write a Rigelfile whose talker has this rate."""
    nodes = {
        "talker": {"args": ["python3", "-c", TALKER, str(rate)]},
        "listener": {"args": ["python3", "-c", LISTENER]},
    }
    options = {"image": image, "namespace": namespace, "network": "peers", "nodes": nodes}
    more = {"expect": {"chatter": EXPECTED}, "rollback_on": {"graph_worse": True, "within": "6s"}}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": {**options, **more}}
    whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
    (folder / "Rigelfile").write_text(yaml.safe_dump(whole))


def test_an_update_keeps_what_is_expected(
    rigel_as_deployer: Rigel, namespace: str, ros2_image: str, tmp_path: Path
) -> None:
    """All of it is measured; what is learned contains it; a tenth of the rate is rolled back."""
    rigel = rigel_as_deployer
    write(tmp_path, namespace, ros2_image, 20)
    rigel("run", "job", "deploy", cwd=tmp_path)
    found = json.loads(rigel("expect", "-o", "json", cwd=tmp_path).stdout)
    states = {one["what"]: one["state"] for one in found["verdicts"]}
    assert states == dict.fromkeys(
        ("type", "rate", "gap", "age", "publishers", "subscribers"), "ok"
    )
    done = rigel("expect", "learn", "--for", "2s", cwd=tmp_path)
    learned = yaml.safe_load(done.stdout)["expect"]
    assert list(learned) == ["/chatter"]
    assert learned["/chatter"].keys() >= {"type", "rate", "publishers"}
    assert "gap" in learned["/chatter"] or "no gap is proposed for /chatter" in done.stderr

    write(tmp_path, namespace, ros2_image, 2)
    done = rigel("run", "job", "deploy", cwd=tmp_path, check=False)
    assert done.returncode == 1
    assert "/chatter: rate" in done.stderr
    assert "rolled back to revision 1" in done.stderr
    status = rigel("status", cwd=tmp_path).stdout
    assert re.search(r"revision 2 was rolled back to revision 1: .*/chatter: rate", status)
    assert rigel("expect", cwd=tmp_path).returncode == 0

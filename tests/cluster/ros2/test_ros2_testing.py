"""`rigel test` with real nodes: a robot, its tests, what they leave; nothing else stays."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.listing import list_releases

from ..conftest import Rigel

pytestmark = pytest.mark.cluster

TALKER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talker")
out = node.create_publisher(String, "chatter", 10)
node.create_timer(0.05, lambda: out.publish(String(data="hello")))
rclpy.spin(node)
"""
#: Passes when it has heard a topic, and writes what.
LISTENER = """
import rclpy, sys, time
from std_msgs.msg import String
rclpy.init()
node, heard = rclpy.create_node("hears"), []
node.create_subscription(String, sys.argv[1], lambda one: heard.append(one.data), 10)
end = time.monotonic() + float(sys.argv[2])
while not heard and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
open("/results/heard.txt", "w").write(" ".join(heard[:1]))
assert heard, "nothing on " + sys.argv[1]
"""


def write(folder: Path, image: str, **more: Any) -> None:
    """Write a Rigelfile with a talker, a test that hears it, and more nodes."""
    nodes = {
        "talker": {"args": ["python3", "-c", TALKER]},
        "hears": {"kind": "test", "args": ["python3", "-c", LISTENER, "chatter", "60"]},
        **more,
    }
    expected = {"chatter": {"rate": "5..", "publishers": 1}}
    options = {"image": image, "network": "peers", "nodes": nodes, "expect": expected}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    whole = {"application": {"distro": "jazzy"}, "jobs": {"robot": job}}
    (folder / "Rigelfile").write_text(yaml.safe_dump(whole))


def read_states(folder: Path) -> dict[str, list[str]]:
    """Return what rigel.xml has of each test."""
    root = ElementTree.parse(folder / "rigel.xml").getroot()
    cases = root.iter("testcase")
    return {one.attrib["name"]: [child.tag for child in one] for one in cases}


def test_a_robot_is_tested_in_a_namespace_of_its_own(
    rigel: Rigel, cluster: Cluster, ros2_image: str, tmp_path: Path
) -> None:
    """A test that fails is the exit code; its files, its words and all logs are saved."""
    deaf = {"kind": "test", "args": ["python3", "-c", LISTENER, "silence", "1"]}
    write(tmp_path, ros2_image, hears_silence=deaf)
    done = rigel("test", "robot", cwd=tmp_path, check=False)
    assert done.returncode == 1, done.stderr
    assert re.search(r"hears +passed", done.stdout)
    assert re.search(r"hears_silence +failed .*AssertionError: nothing on silence", done.stdout)
    results = tmp_path / "test-results"
    assert (results / "hears" / "heard.txt").read_text() == "hello"
    states = read_states(results)
    assert states["/chatter: rate"] == states["/chatter: publishers"] == []
    assert states["hears"] == []
    assert states["hears_silence"] == ["failure", "system-out"]
    logs = sorted(path.name for path in (results / "logs").iterdir())
    assert [re.split("[-.]", name)[0] for name in logs] == ["hears", "hears", "talker"]
    namespace = re.search(r"robot-test-\w{6}", done.stderr + done.stdout)
    assert namespace
    live = cluster.get(ObjectRef("v1", "Namespace", "", namespace[0]))
    assert live is None or live["status"]["phase"] == "Terminating"


def test_a_deployer_tests_in_a_given_namespace(
    rigel_as_deployer: Rigel, cluster: Cluster, namespace: str, ros2_image: str, tmp_path: Path
) -> None:
    """It stays, without what was tested. One that has a release is refused; `run` tests nothing."""
    rigel = rigel_as_deployer
    write(tmp_path, ros2_image)
    done = rigel("test", "robot", "-n", namespace, "--output", "out", cwd=tmp_path)
    assert done.returncode == 0
    assert read_states(tmp_path / "out")["hears"] == []
    assert list_releases(cluster, namespace) == []
    rigel("run", "robot", "-n", namespace, cwd=tmp_path)
    workloads = cluster.list("apps/v1", "Deployment", namespace)
    assert [one["metadata"]["name"] for one in workloads] == ["talker"]
    done = rigel("test", "robot", "-n", namespace, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert "has the release rigel-k8s-application" in done.stderr

"""`kind: task` with real nodes: it runs once, is waited for, and fails with its last words."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef

from ..conftest import Rigel
from .test_ros2_testing import TALKER

pytestmark = pytest.mark.cluster

#: Ends when it has heard the talker; with a second word, it then fails.
HEARS = """
import rclpy, sys
from std_msgs.msg import String
rclpy.init()
node, heard = rclpy.create_node("any"), []
node.create_subscription(String, "chatter", lambda one: heard.append(one.data), 10)
while not heard:
    rclpy.spin_once(node, timeout_sec=0.1)
print(node.get_name(), "heard", heard[0], flush=True)
assert len(sys.argv) < 3 or sys.argv[2] != "fail", "asked to fail"
"""


def write(folder: Path, image: str, *words: str) -> None:
    """Write a Rigelfile with a talker and a task that hears it."""
    nodes = {
        "talker": {"args": ["python3", "-c", TALKER]},
        "hears": {"kind": "task", "args": ["python3", "-c", HEARS, "once", *words]},
    }
    options = {"image": image, "network": "peers", "network_policy": True, "nodes": nodes}
    job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
    whole = {"application": {"distro": "jazzy"}, "jobs": {"robot": job}}
    (folder / "Rigelfile").write_text(yaml.safe_dump(whole))


def find_job(cluster: Cluster, namespace: str) -> dict[str, str]:
    live = cluster.get(ObjectRef("batch/v1", "Job", namespace, "hears"))
    assert live is not None
    meta: dict[str, str] = live["metadata"]
    return meta


def test_a_task_from_its_first_run_to_its_end(
    rigel_as_deployer: Rigel, cluster: Cluster, namespace: str, ros2_image: str, tmp_path: Path
) -> None:
    """Its log stays, nothing misses it in the graph; what is unchanged and succeeded stays so."""

    def rigel(*words: str, code: int = 0) -> str:
        done = rigel_as_deployer("-n", namespace, *words, cwd=tmp_path, check=False)
        assert done.returncode == code, done.stdout + done.stderr
        return str(done.stdout + done.stderr)

    write(tmp_path, ros2_image)
    rigel("run", "robot")
    assert "hears heard hello" in rigel("logs", "hears")
    seen = rigel("status")
    [row] = [line.split() for line in seen.splitlines() if line.startswith("hears ")]
    assert row[2] == "done"
    assert "2 of 2 ready" in seen
    found = json.loads(rigel("graph", "-o", "json"))
    assert [one["name"] for one in found["nodes"]] == ["/talker"]
    uids = [find_job(cluster, namespace)["uid"]]
    rigel("run", "robot")
    assert find_job(cluster, namespace)["uid"] == uids[0]
    rigel("restart", "hears")
    uids.append(find_job(cluster, namespace)["uid"])

    write(tmp_path, ros2_image, "fail")
    lines = [one for one in rigel("diff", "robot").splitlines() if one[:2] in ("+ ", "- ")]
    assert [one.split() for one in lines] == [["+", "-", "fail"]]
    words = "container ros-node exited with code 1 (AssertionError: asked to fail"
    for _ in range(2):  # the second time nothing has changed, but that it has failed
        assert f"hears did not succeed: {words}" in rigel("run", "robot", code=1)
        uids.append(find_job(cluster, namespace)["uid"])
    assert words in rigel("status", code=1)
    rigel("rollback")
    uids.append(find_job(cluster, namespace)["uid"])
    assert len(set(uids)) == 5
    rigel("status")

    rigel("down")
    assert cluster.list("batch/v1", "Job", namespace) == []
    assert cluster.list("v1", "Pod", namespace) == []

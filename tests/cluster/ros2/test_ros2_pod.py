"""Two nodes of one pod on real ROS 2: images of 6 MB by shared memory, and one hand-over of both.

Each node has a container of its own; whoever asks for a node gets that one.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from tests.support.until import until

from ..background import Background
from ..conftest import own_namespace
from .conftest import apart

pytestmark = [pytest.mark.cluster, pytest.mark.slow]

#: Sends 6 MB five times a second, numbered; two containers of a pod begin with the same numbers.
CAMERA = """
import array, os, struct, rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import UInt8MultiArray
rclpy.init()
node = rclpy.create_node("camera")
publisher = node.create_publisher(UInt8MultiArray, "image", qos_profile_sensor_data)
count, version = 0, int(os.environ["VERSION"])
def send():
    global count
    count += 1
    data = struct.pack("QQ", version, count).ljust(6_000_000)
    publisher.publish(UInt8MultiArray(data=array.array("B", data)))
node.create_timer(0.2, send)
print("camera of version", version, flush=True)
rclpy.spin(node)
"""
DETECTOR = """
import os, struct, time, rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import UInt8MultiArray
rclpy.init()
node = rclpy.create_node("detector")
def take(image):
    version, count = struct.unpack("QQ", bytes(image.data[:16]))
    sizes = len(image.data), time.time()
    print("detector", os.environ["VERSION"], "has", version, count, *sizes, flush=True)
node.create_subscription(UInt8MultiArray, "image", take, qos_profile_sensor_data)
rclpy.spin(node)
"""
#: The detector's version, the camera's, the number, and when it was taken.
TAKEN = re.compile(r"detector (\d+) has (\d+) (\d+) 6000000 ([0-9.]+)")
NODES = ("camera", "detector")
IMAGE = 6_000_000
#: Of the images, how many a detector may miss that gets no processor time: its queue is short.
SPARE = 0.1


@attrs.frozen
class Robot:
    """The deployment of two nodes in the pod `perception`."""

    file: Path
    namespace: str
    image: str
    context: str
    cluster: Any
    domain: int

    def line(self, *words: str) -> list[str]:
        """Return a command line of rigel."""
        place = ["-f", str(self.file), "--context", self.context, "-n", self.namespace]
        return [sys.executable, "-m", "rigel_k8s", *place, *words]

    def rigel(self, *words: str, fails: bool = False) -> str:
        """Return what rigel prints; only if it `fails`, errors too."""
        done = subprocess.run(
            self.line(*words), capture_output=True, text=True, timeout=300, check=False
        )
        assert bool(done.returncode) == fails, done.stdout + done.stderr
        return done.stdout + (done.stderr if fails else "")

    def update(self, version: int, detector: str = DETECTOR, *, fails: bool = False) -> str:
        """Deploy a version of both."""
        nodes = {
            name: {
                "pod": "perception",
                "args": ["python3", "-c", program],
                "env": {"VERSION": version},
            }
            for name, program in (("camera", CAMERA), ("detector", detector))
        }
        network = {"mode": "peers", "domain_id": self.domain}
        job = {
            "plugin": "rigel_k8s.OrchestrationPlugin",
            "with": {"image": self.image, "network": network, "nodes": nodes},
        }
        whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
        self.file.write_text(json.dumps(whole))
        return self.rigel("run", "job", "deploy", "--timeout", "4m", fails=fails)

    def pods(self) -> list[dict[str, Any]]:
        """Return the pods that have not ended."""
        labels = {"app.kubernetes.io/name": "perception"}
        found: list[dict[str, Any]] = self.cluster.list("v1", "Pod", self.namespace, labels=labels)
        return found

    def count_sent(self) -> int:
        """Return the bytes that the pod has sent on all its interfaces, to itself too."""
        lines = self.rigel("exec", "camera", "--", "cat", "/proc/net/dev").splitlines()
        return sum(int(line.partition(":")[2].split()[8]) for line in lines if ":" in line)

    def taken(self) -> list[int]:
        """Return the numbers of the images that the detector has."""
        return [int(match[2]) for match in TAKEN.findall(self.rigel("logs", "detector"))]


@pytest.fixture(scope="module")
def robot(
    tmp_path_factory: pytest.TempPathFactory, ros2_image: str, context: str, admin: Any
) -> Iterator[Robot]:
    """Version 1 of both nodes."""
    file, domain = tmp_path_factory.mktemp("pod") / "Rigelfile", apart(ros1=False)["domain_id"]
    with own_namespace(admin, "t-pod") as namespace:
        made = Robot(file, namespace, ros2_image, context, admin, domain)
        made.update(1)
        yield made


def count_missing(numbers: list[int]) -> int:
    """Return how many numbers are missing between the first and the last."""
    return numbers[-1] - numbers[0] + 1 - len(set(numbers))


def test_images_of_6_mb_arrive_without_a_gap(robot: Robot) -> None:
    """One pod, a container for each node, one /dev/shm: nothing goes over UDP."""
    (pod,) = robot.pods()
    assert [one["name"] for one in pod["spec"]["containers"]] == [*NODES]
    until(lambda: len(robot.taken()) > 20, "images", 90, every=1.0)
    taken, sent = len(robot.taken()), robot.count_sent()
    until(lambda: len(robot.taken()) > taken + 20, "more images", 90, every=1.0)
    assert count_missing(robot.taken()) <= len(robot.taken()) * SPARE
    assert robot.count_sent() - sent < IMAGE  # not even one of them


def test_each_node_is_found_by_its_name(robot: Robot) -> None:
    """Status, logs, exec, top's names and the graph name nodes, although they have one pod."""
    found = json.loads(robot.rigel("status", "-o", "json"))
    assert [(one["name"], one["ros_name"], one["ready"]) for one in found["workloads"]] == [
        ("camera", "/camera", 1),
        ("detector", "/detector", 1),
    ]
    assert len({one["pods"][0]["name"] for one in found["workloads"]}) == 1
    assert "camera of version 1" in robot.rigel("logs", "camera")
    assert "detector 1" not in robot.rigel("logs", "camera")
    for name in NODES:
        assert robot.rigel("exec", name, "--", "printenv", "RIGEL_RMW").strip().endswith(f"/{name}")
    graph = json.loads(robot.rigel("graph", "-o", "json"))
    assert {(one["name"], one["workload"]) for one in graph["nodes"]} == {
        ("/camera", "camera"),
        ("/detector", "detector"),
    }
    (topic,) = (one for one in graph["topics"] if one["name"] == "/image")
    assert topic["shared"] == [["/camera", "/detector"]]
    assert {one["memory"] for one in found["graph"]["pods"]} == {
        f"pod {found['workloads'][0]['pods'][0]['name']}"
    }
    text = robot.rigel("status")
    assert ": camera, detector" in text.partition("by shared memory of the pod")[2]


def test_both_are_handed_over_together(robot: Robot) -> None:
    """The new pod takes over with both nodes; images go on, and none is taken twice."""
    (old,) = robot.pods()
    with Background(robot.line("logs", "--follow", "--tail", "0", "detector")) as follower:
        until(lambda: follower.found("detector 1 has 1"), "images of the old ones", 90)
        robot.update(2)
        for name in NODES:
            state = robot.rigel("exec", name, "--", "python3", "/rigel-k8s/keeper.py", "state")
            assert f"took over from {old['metadata']['name']}" in state
        until(lambda: follower.found("detector 2 has 2"), "images of the new ones", 90)
        until(lambda: len(robot.pods()) == 1, "end of the old pod", 120, every=1.0)
    found = TAKEN.findall("\n".join(follower.lines))
    images = [(int(camera), int(number)) for _, camera, number, _ in found]
    assert len(images) == len(set(images))
    for version in ("1", "2"):
        own = [int(number) for one, other, number, _ in found if one == other == version]
        assert count_missing(own) <= len(own) * SPARE
    # Between the moments of the two nodes, of a fraction of a second, images reach no one.
    last = max(float(when) for detector, _, _, when in found if detector == "1")
    first = min(float(when) for detector, _, _, when in found if detector == "2")
    assert first - last < 10


def test_a_node_that_fails_leaves_the_old_pod_as_it_is(robot: Robot) -> None:
    """Its neighbor, which could take over, does not: it would be alone in the new pod."""
    (old,) = robot.pods()
    said = robot.update(3, "raise SystemExit(3)", fails=True)
    assert "container detector exited with code 3" in said
    name = old["metadata"]["name"]
    for node in NODES:
        line = ["/bin/sh", "/rigel-k8s/exec.sh", "python3", "/rigel-k8s/keeper.py", "state"]
        done = robot.cluster.run(robot.namespace, name, line, container=node, timeout=60)
        assert done.stdout.decode().startswith("works"), done
    seen = len(TAKEN.findall("\n".join(robot.cluster.logs(robot.namespace, name, "detector"))))
    until(
        lambda: (
            len(TAKEN.findall("\n".join(robot.cluster.logs(robot.namespace, name, "detector"))))
            > seen + 5
        ),
        "images in the old pod",
        60,
    )
    status = json.loads(robot.rigel("status", "-o", "json", fails=True).partition("\n\n")[0])
    assert "detector" in status["workloads"][1]["message"]

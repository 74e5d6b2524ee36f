"""A machine with ROS 2 nodes is cut off and returns: what is bound to it stays, the rest moves.

`AWAY=600` cuts it off for ten minutes.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest
import yaml

from ..machines import AWAY, EVICTED, LEAVES, PATIENCE, choose_machines, cut_off, prefer, until_away
from .conftest import Project

pytestmark = [pytest.mark.cluster, pytest.mark.slow]  # a cluster of its own

TALKER = """
import itertools, sys, rclpy
from std_msgs.msg import String
rclpy.init()
name, numbers = sys.argv[1], itertools.count()
node = rclpy.create_node(name)
publisher = node.create_publisher(String, name, 10)
node.create_timer(0.1, lambda: publisher.publish(String(data="%s %d" % (name, next(numbers)))))
rclpy.spin(node)
"""
LISTENER = """
import sys, time, rclpy, rclpy.utilities
from std_msgs.msg import String
rclpy.init()
name, *topics = rclpy.utilities.remove_ros_args(sys.argv)[1:]
node = rclpy.create_node(name)
for topic in topics:
    say = lambda message: print("heard", message.data, time.time(), flush=True)
    node.create_subscription(String, topic, say, 10)
rclpy.spin(node)
"""
HEARD = re.compile(r"heard (\w+) (\d+) ([\d.]+)")
NETWORKS: dict[str, dict[str, Any]] = {
    "peers": {"mode": "peers"},
    "macvlan": {"mode": "macvlan", "interface": "eth0", "ipam": "static"},
}
TALKERS = {"bound", "free", "waits"}


def run(text: str, *args: str) -> dict[str, Any]:
    """Return a node that runs Python code."""
    return {"args": ["python3", "-c", text, *args]}


def nodes(lost: str, stays: str) -> dict[str, Any]:
    """Return talkers and a listener on a machine that will be lost, and a listener elsewhere."""
    leaves = {"tolerations": LEAVES, "patch": prefer(lost)}
    return {
        "bound": run(TALKER, "bound") | {"placement": {"node": lost}},
        "waits": run(TALKER, "waits") | {"patch": prefer(lost)},
        "free": run(TALKER, "free") | leaves,
        "ears": run(LISTENER, "ears", "free") | leaves,
        "listener": run(LISTENER, "listener", *sorted(TALKERS)) | {"placement": {"node": stays}},
    }


@pytest.fixture(params=NETWORKS)
def robot(own_cluster: Callable[..., Project], request: Any) -> Project:
    """All nodes but one listener on one machine, deployed."""
    network = dict(NETWORKS[request.param])
    made = own_cluster(
        "ros2-talker-listener", change=lambda options: options.update(network=network)
    )
    written = yaml.safe_load(made.rigelfile.read_text())
    written["jobs"]["deploy"]["with"] |= {
        "image": "{{ vars.BASE_IMAGE }}",
        "nodes": nodes(*choose_machines(made.cluster)),
    }
    made.rigelfile.write_text(yaml.safe_dump(written))
    made("run", "job", "deploy")
    return made


def status(robot: Project) -> Any:
    """Return what `rigel status` prints for scripts."""
    return json.loads(robot("status", "-o", "json", check=False).stdout)


def every_uid(robot: Project) -> dict[str, list[str]]:
    """Return the UIDs of each workload's pods, those on their way out too."""
    found: dict[str, list[str]] = {}
    for pod in robot.cluster.list("v1", "Pod", robot.space):
        name = pod["metadata"]["labels"]["app.kubernetes.io/name"]
        found.setdefault(name, []).append(pod["metadata"]["uid"])
    return found


def is_replaced(robot: Project, workload: str, uids: list[str]) -> bool:
    """Return whether a workload has another pod than these."""
    pod = robot.pods().get(workload)  # none for a moment
    return pod is not None and pod["metadata"]["uid"] not in uids


def heard(robot: Project, workload: str, *, since: int | None = None) -> dict[str, list[int]]:
    """Return the numbers that a listener has heard from each talker."""
    pod = robot.pods()[workload]["metadata"]["name"]
    numbers: dict[str, list[int]] = {}
    for line in robot.cluster.logs(robot.space, pod, since_seconds=since):
        if match := HEARD.search(line):
            numbers.setdefault(match[1], []).append(int(match[2]))
    return numbers


def until_heard(robot: Project, workload: str, talkers: set[str]) -> None:
    """Wait until a listener hears exactly these talkers."""
    robot.until(
        lambda: set(heard(robot, workload, since=2)) == talkers,
        f"messages of exactly {sorted(talkers)}",
        seconds=PATIENCE,
    )


def test_a_machine_that_is_cut_off_and_returns(robot: Project) -> None:
    """Pods that may leave are replaced and talk; those that stay go on when it is back."""
    cluster, look = robot.context.removeprefix("rigel-"), partial(status, robot)
    until_heard(robot, "listener", TALKERS)
    until_away(look, ())
    uids, leaving = every_uid(robot), {"free", "ears"}
    stay = {"bound"} | ({"waits"} if AWAY < EVICTED else set())
    with cut_off(cluster, robot.machines()["bound"]):
        robot.until(
            lambda: all(is_replaced(robot, name, uids[name]) for name in leaving),
            "pods on other machines",
            seconds=PATIENCE,
        )
        time.sleep(AWAY)
        until_away(look, stay)
        until_heard(robot, "listener", TALKERS - stay)
        until_heard(robot, "ears", {"free"})
        before = heard(robot, "listener")["bound"][-1]
    robot.until(
        lambda: all(len(pods) == 1 for pods in every_uid(robot).values()),
        "end of the pods that were replaced",
        seconds=PATIENCE,
    )
    until_away(look, ())
    until_heard(robot, "listener", TALKERS)
    after = every_uid(robot)
    assert {name for name in uids if uids[name] == after[name]} == stay | {"listener"}
    numbers = heard(robot, "listener")["bound"]
    assert numbers == sorted(numbers)  # it has not started again
    assert numbers[-1] > before

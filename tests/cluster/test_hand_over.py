"""Updates and a lost roscore that the ROS graph does not notice: the gate, on a real cluster."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.support.until import until

from .conftest import own_namespace
from .robot import Robot

pytestmark = pytest.mark.cluster

#: Says which version it is and counts.
TALKER = """
import os, sys
if os.environ["VERSION"] == "broken":
    sys.exit("no camera")
import rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=10)
rate, number = rospy.Rate(20), 0
while not rospy.is_shutdown():
    publisher.publish("%s %d" % (os.environ["VERSION"], number))
    number += 1
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
"""
LISTENER = """
import time, rospy, std_msgs.msg
rospy.init_node("listener")
def hear(message):
    print("heard %.4f %s" % (time.time(), message.data))
rospy.Subscriber("/chatter", std_msgs.msg.String, hear)
rospy.spin()
"""
HEARS = "rostopic echo -n 1 /chatter"


class Talking(Robot):
    """A talker and a listener on two machines."""

    def update(self, version: str, *, check: bool = True, **more: Any) -> Any:
        """Deploy the talker in a version."""
        env = {"VERSION": version}
        nodes = {
            "talker": {
                "args": ["python3", "-c", TALKER],
                "env": env,
                "placement": {"apart_from": ["listener"]},
            },
            "listener": {"args": ["python3", "-c", LISTENER]},
        }
        self.write(nodes, **more)
        return self.rigel("run", "job", "deploy", "--timeout", "4m", check=check)

    def heard(self) -> list[tuple[float, str, int]]:
        """Return (time, version, number) of what the listener has heard."""
        text = self.rigel("logs", "listener").stdout
        found = re.findall(r"heard ([\d.]+) (\w+) (\d+)$", text, re.MULTILINE)
        return [(float(when), version, int(number)) for when, version, number in found]

    def until_heard(self, version: str) -> None:
        """Wait until the listener hears a version."""
        until(
            lambda: [heard for _, heard, _ in self.heard()[-1:]] == [version],
            f"messages of {version}",
            180,
            every=0.5,
        )

    def uid(self, name: str) -> str:
        """Return which pod a workload has."""
        (pod,) = self.pods(name)
        return str(pod["metadata"]["uid"])


@pytest.fixture(scope="module")
def robot(
    tmp_path_factory: pytest.TempPathFactory, base_image: str, rigel: Any, cluster: Any
) -> Iterator[Talking]:
    """The talker in version v1, heard."""
    with own_namespace(cluster, "t-gate") as namespace:
        made = Talking(tmp_path_factory.mktemp("robot"), namespace, base_image, rigel, cluster)
        made.update("v1")
        made.until_heard("v1")
        yield made


def test_a_newcomer_that_fails_changes_nothing(robot: Talking) -> None:
    """The roll-out fails with its cause, and the old talker is heard all the time."""
    before, pod = robot.heard()[-1], robot.uid("talker")
    done = robot.update("broken", check=False)
    assert done.returncode == 1
    assert "no camera" in done.stdout + done.stderr
    assert [one["metadata"]["uid"] for one in robot.pods("talker")].count(pod) == 1
    after = until(lambda: (h := robot.heard()[-1])[0] > before[0] + 1 and h, "messages", 120)
    assert after[1] == before[1]
    robot.update("v3")
    robot.until_heard("v3")


def test_a_roscore_that_was_killed_knows_everyone_again(robot: Talking) -> None:
    """Who subscribes then hears the talker, parameters are there, and no pod has restarted."""
    pods = {name: robot.uid(name) for name in ("talker", "listener")}
    robot.run("talker", "rosparam", "set", "/robot/name", "rosie")
    robot.run("ros-master", "pkill", "-9", "rosmaster")
    assert "v3" in robot.run("listener", "sh", "-c", HEARS)
    assert robot.run("listener", "rosparam", "get", "/robot/name").strip() == "rosie"
    assert {name: robot.uid(name) for name in pods} == pods


def test_an_update_of_the_master_goes_unnoticed(robot: Talking) -> None:
    """Its nodes stay, and not one message of the talker is missed."""
    pods = {name: robot.uid(name) for name in ("talker", "listener")}
    before = robot.heard()[-1][2]
    changed = {"spec": {"template": {"metadata": {"annotations": {"generation": "2"}}}}}
    robot.update("v3", additional_k8s_params={"ros_master": changed})
    robot.until_master_answers("listener")
    assert "v3" in robot.run("listener", "sh", "-c", HEARS)
    assert {name: robot.uid(name) for name in pods} == pods
    numbers = [number for _, version, number in robot.heard() if version == "v3"]
    heard = numbers[numbers.index(before) :]
    assert len(heard) > 1
    assert heard == list(range(before, before + len(heard)))

"""The machine of ros-master is lost or cut off: on another one the master goes on.

No node has to restart for that, and what is bound to the machine is as it was when that is back.
"""

from __future__ import annotations

import json
import re
import sys
import time
import uuid
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from tests.support.until import until

from .conftest import run_rigel
from .machines import (
    AWAY,
    LEAVES,
    LOST,
    PATIENCE,
    choose_machines,
    cut_off,
    lose,
    own_cluster,
    prefer,
    until_away,
)
from .robot import Robot

pytestmark = [pytest.mark.cluster, pytest.mark.slow]  # a cluster of its own

TALKER = """
import rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=10)
rate, number = rospy.Rate(20), 0
while not rospy.is_shutdown():
    publisher.publish("number %d" % number)
    number += 1
    rate.sleep()
"""
LISTENER = """
import rospy, std_msgs.msg
rospy.init_node("listener")
rospy.Subscriber("chatter", std_msgs.msg.String, lambda message: print("heard " + message.data))
rospy.spin()
"""
#: Prints the times of the master's first answer and of the first one that has all, if there are.
WATCH = """
import socket, sys, time, xmlrpc.client
socket.setdefaulttimeout(2)
names, first, deadline = set(sys.argv[1:]), None, time.time() + 30
while time.time() < deadline:
    try:
        master = xmlrpc.client.ServerProxy("http://ros-master:11311")
        parts = master.getSystemState("/watch")[2]
        first = first or time.time()
        known = {"%s %s" % (key, name) for part in parts for key, own in part for name in own}
        if names <= known and master.getParam("/watch", "/robot/name")[2] == "rosie":
            print(first, time.time())
            break
    except (OSError, xmlrpc.client.Fault) as error:
        print(error, file=sys.stderr)
    time.sleep(0.1)
"""
HEARS = "rostopic echo -n 1 /chatter"
#: Prints the errors of twenty calls, each over a connection of its own.
CALLS = """
import socket, xmlrpc.client
socket.setdefaulttimeout(20)
for _ in range(20):
    try:
        xmlrpc.client.ServerProxy("http://ros-master:11311").getUri("/calls")
    except Exception as error:
        print(repr(error))
"""
#: How long ros-master waits for a machine that is out of reach; 300 s unless this is set.
MASTER_LEAVES = [
    {"key": key, "operator": "Exists", "effect": "NoExecute", "tolerationSeconds": 5}
    for key in LOST
]


@pytest.fixture(scope="module")
def own() -> Iterator[tuple[str, str]]:
    """Return (name, registry with the base image) of a cluster whose machines may be lost."""
    with own_cluster("test-lost", nodes=2) as (name, registry):
        run_rigel("image", "ros1-base", "--push", f"{registry}/ros:noetic")
        yield name, registry


@pytest.fixture
def robot(own: tuple[str, str], tmp_path: Any) -> Iterator[Robot]:
    """A talker and a listener on one machine; ros-master and two more talkers on the other."""
    from rigel_k8s.kube import connect
    from rigel_k8s.settings import Settings

    name, registry = own
    context = f"rigel-{name}"
    namespace = f"t-lost-{uuid.uuid4().hex[:6]}"
    with connect(Settings(context=context)) as cluster:
        second, first = choose_machines(cluster)
        cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": namespace}})
        call = partial(run_rigel, "--context", context)
        made = Robot(tmp_path, namespace, f"{registry}/ros:noetic", call, cluster)
        programs = {"talker": TALKER, "listener": LISTENER}
        nodes = {
            key: {"args": ["python3", "-c", text], "placement": {"node": first}}
            for key, text in programs.items()
        }
        nodes["bound"] = {"args": talk("bound"), "placement": {"node": second}}
        nodes["free"] = {"args": talk("free"), "tolerations": LEAVES, "patch": prefer(second)}
        master = prefer(second)
        master["spec"]["template"]["spec"]["tolerations"] = MASTER_LEAVES
        made.write(nodes, additional_k8s_params={"ros_master": master})
        made.deploy()
        yield made
        cluster.delete(ObjectRef("v1", "Namespace", "", namespace))


def talk(name: str) -> list[str]:
    """Return what a talker runs whose topic has its own name."""
    return ["python3", "-c", TALKER.replace("talker", name).replace("chatter", name)]


def status(robot: Robot) -> Any:
    """Return what `rigel status` prints for scripts."""
    return json.loads(robot.rigel("status", "-o", "json", check=False).stdout)


def number(robot: Robot) -> int:
    """Return the last number that the listener has heard."""
    found = re.findall(r"heard number (\d+)", robot.rigel("logs", "listener").stdout)
    return int(found[-1]) if found else -1


def uids(robot: Robot) -> list[str]:
    """Return which pods the nodes have."""
    return [
        str(pod["metadata"]["uid"]) for one in ("talker", "listener") for pod in robot.pods(one)
    ]


def test_a_machine_that_is_cut_off_and_returns(own: tuple[str, str], robot: Robot) -> None:
    """`AWAY=600` cuts it off for ten minutes."""
    robot.run("talker", "rosparam", "set", "/robot/name", "rosie")
    until(lambda: number(robot) > 0, "messages")
    time.sleep(2)  # the gate writes to the cluster once a second
    look = partial(status, robot)
    until_away(look, ())
    (master,), (bound,), stayed = robot.pods("ros-master"), robot.pods("bound"), uids(robot)
    machine = master["spec"]["nodeName"]
    assert machine == bound["spec"]["nodeName"]
    with cut_off(own[0], machine):
        until(
            lambda: robot.ready("ros-master") and name_of(robot) != master["metadata"]["name"],
            "another master",
            PATIENCE,
            every=1,
        )
        end = time.time() + AWAY
        while True:
            assert robot.run("listener", "python3", "-c", CALLS) == ""
            if time.time() > end:
                break
            time.sleep(5)
        assert "rosie" in robot.run("talker", "rosparam", "get", "/robot/name")
        assert "number" in robot.run("listener", "sh", "-c", HEARS.replace("chatter", "free"))
        until_away(look, {"bound"})
        before = number(robot)
    until(
        lambda: robot.ready("bound"), "the node on the machine that was cut off", PATIENCE, every=1
    )
    until(
        lambda: len(robot.every_pod("ros-master")) == 1,
        "the end of the old master",
        PATIENCE,
        every=1,
    )
    until(lambda: len(robot.every_pod("free")) == 1, "the end of the old node", PATIENCE, every=1)
    until_away(look, ())
    for topic in ("bound", "free"):
        assert "number" in robot.run("listener", "sh", "-c", HEARS.replace("chatter", topic))
    assert robot.pods("bound")[0]["metadata"]["uid"] == bound["metadata"]["uid"]
    assert uids(robot) == stayed
    assert number(robot) > before


def name_of(robot: Robot) -> str:
    """Return the name of ros-master's pod."""
    return str(robot.pods("ros-master")[0]["metadata"]["name"])


def test_a_master_whose_machine_is_lost_goes_on_elsewhere(
    own: tuple[str, str], robot: Robot
) -> None:
    """Its pod is deleted by force, as an operator does; `-s` shows the seconds that it takes."""
    robot.run("talker", "rosparam", "set", "/robot/name", "rosie")
    until(lambda: number(robot) > 0, "messages")
    pods, (master,) = uids(robot), robot.pods("ros-master")
    machine = master["spec"]["nodeName"]
    assert machine not in {pod["spec"]["nodeName"] for pod in robot.pods("talker")}
    time.sleep(2)  # the gate writes to the cluster once a second
    lose(own[0], machine)
    lost = time.time()
    until(lambda: not is_up(robot, machine), f"the end of {machine}", PATIENCE, every=1)
    before = number(robot)
    name = master["metadata"]["name"]
    robot.cluster.delete(ObjectRef("v1", "Pod", robot.namespace, name), grace_seconds=0)
    deleted = time.time()
    sys.stdout.write(f"Kubernetes saw the loss after {deleted - lost:.0f} s\n")
    watch = ("python3", "-c", WATCH, "/chatter /talker", "/chatter /listener", "/rosout /talker")
    found = until(
        lambda: robot.run("listener", *watch).split(),
        "a master that knows everything",
        PATIENCE,
        last_words=lambda: [pod["status"] for pod in robot.pods("ros-master")],
    )
    answered, complete = map(float, found)
    sys.stdout.write(
        f"the first answer {answered - deleted:.1f} s after the deletion, everything back"
        f" {complete - answered:.1f} s later\n"
    )
    assert "number" in robot.run("listener", "sh", "-c", HEARS)
    assert uids(robot) == pods
    assert robot.pods("ros-master")[0]["spec"]["nodeName"] != machine
    assert number(robot) > before


def is_up(robot: Robot, machine: str) -> bool:
    """Return whether Kubernetes hears from a machine."""
    found = robot.cluster.get(ObjectRef("v1", "Node", "", machine))
    return any(
        one["type"] == "Ready" and one["status"] == "True" for one in found["status"]["conditions"]
    )

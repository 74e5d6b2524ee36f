"""The machine of ros-master is lost: on another one it goes on, and no node has to restart."""

from __future__ import annotations

import json
import os
import re
import sys
import time
import uuid
from collections.abc import Iterator
from functools import partial
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef
from tests.support import shared
from tests.support.until import until

from .conftest import run_rigel
from .machines import lose
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


@pytest.fixture(scope="module")
def own() -> Iterator[tuple[str, str]]:
    """Return (name, registry with the base image) of a cluster whose machines may be lost."""
    if os.geteuid() != 0:
        pytest.skip("the local cluster needs root")
    name = shared.mine("test-lost")
    run_rigel("cluster", "down", "--name", name)  # that of a run that was killed
    run_rigel("cluster", "up", "--name", name, "--nodes", "2", timeout=900)
    try:
        told = run_rigel("cluster", "status", "--name", name, "-o", "json").stdout
        registry = json.loads(told)["registry"]
        run_rigel("image", "ros1-base", "--push", f"{registry}/ros:noetic")
        yield name, registry
    finally:
        run_rigel("cluster", "down", "--name", name)


@pytest.fixture
def robot(own: tuple[str, str], tmp_path: Any) -> Iterator[Robot]:
    """A talker and a listener on one machine, ros-master on the other."""
    from rigel_k8s.kube import connect
    from rigel_k8s.settings import Settings

    name, registry = own
    context = f"rigel-{name}"
    namespace = f"t-lost-{uuid.uuid4().hex[:6]}"
    with connect(Settings(context=context)) as cluster:
        machines = {one["metadata"]["name"] for one in cluster.list("v1", "Node", None)}
        # The only pod that resolves names would move after five minutes, and ros-master is a name.
        (dns,) = cluster.list(
            "v1", "Pod", "kube-system", labels={"app.kubernetes.io/name": "coredns"}
        )
        first = dns["spec"]["nodeName"]
        (second,) = machines - {first}
        cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": namespace}})
        call = partial(run_rigel, "--context", context)
        made = Robot(tmp_path, namespace, f"{registry}/ros:noetic", call, cluster)
        programs = {"talker": TALKER, "listener": LISTENER}
        nodes = {
            key: {"args": ["python3", "-c", text], "placement": {"node": first}}
            for key, text in programs.items()
        }
        made.write(nodes, additional_k8s_params={"ros_master": prefer(second)})
        made.deploy()
        yield made


def prefer(machine: str) -> dict[str, Any]:
    """Return the part of a Deployment that prefers a machine, and may run elsewhere."""
    term = {"key": "kubernetes.io/hostname", "operator": "In", "values": [machine]}
    preferred = [{"weight": 100, "preference": {"matchExpressions": [term]}}]
    affinity = {"nodeAffinity": {"preferredDuringSchedulingIgnoredDuringExecution": preferred}}
    return {"spec": {"template": {"spec": {"affinity": affinity}}}}


def number(robot: Robot) -> int:
    """Return the last number that the listener has heard."""
    found = re.findall(r"heard number (\d+)", robot.rigel("logs", "listener").stdout)
    return int(found[-1]) if found else -1


def uids(robot: Robot) -> list[str]:
    """Return which pods the nodes have."""
    return [
        str(pod["metadata"]["uid"]) for one in ("talker", "listener") for pod in robot.pods(one)
    ]


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
    until(lambda: not is_up(robot, machine), f"the end of {machine}", 180, every=1)
    before = number(robot)
    name = master["metadata"]["name"]
    robot.cluster.delete(ObjectRef("v1", "Pod", robot.namespace, name), grace_seconds=0)
    deleted = time.time()
    sys.stdout.write(f"Kubernetes saw the loss after {deleted - lost:.0f} s\n")
    watch = ("python3", "-c", WATCH, "/chatter /talker", "/chatter /listener", "/rosout /talker")
    found = until(
        lambda: robot.run("listener", *watch).split(),
        "a master that knows everything",
        240,
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

"""The machine of ros-master is lost or cut off: on another one the master goes on.

No node has to restart for that, and what is bound to the machine is as it was when that is back.
"""

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
from .machines import cut_off, lose
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
#: Seconds that a machine stays cut off once Kubernetes has replaced what may leave it.
AWAY = float(os.environ.get("AWAY", "30"))
#: How long ros-master waits for a machine that is out of reach; 300 s unless this is set.
LEAVES = [
    {"key": f"node.kubernetes.io/{state}", "operator": "Exists", "effect": "NoExecute"}
    | {"tolerationSeconds": 5}
    for state in ("not-ready", "unreachable")
]


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
        args = ["python3", "-c", TALKER.replace("talker", "bound").replace("chatter", "bound")]
        nodes["bound"] = {"args": args, "placement": {"node": second}}
        made.write(nodes, additional_k8s_params={"ros_master": prefer(second)})
        made.deploy()
        yield made


def prefer(machine: str) -> dict[str, Any]:
    """Return the part of a Deployment that prefers a machine, and leaves it when it is lost."""
    term = {"key": "kubernetes.io/hostname", "operator": "In", "values": [machine]}
    preferred = [{"weight": 100, "preference": {"matchExpressions": [term]}}]
    affinity = {"nodeAffinity": {"preferredDuringSchedulingIgnoredDuringExecution": preferred}}
    return {"spec": {"template": {"spec": {"affinity": affinity, "tolerations": LEAVES}}}}


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
    (master,), (bound,), stayed = robot.pods("ros-master"), robot.pods("bound"), uids(robot)
    machine = master["spec"]["nodeName"]
    assert machine == bound["spec"]["nodeName"]
    with cut_off(own[0], machine):
        until(
            lambda: robot.ready("ros-master") and name_of(robot) != master["metadata"]["name"],
            "another master",
            180,
            every=1,
        )
        end = time.time() + AWAY
        while True:
            assert robot.run("listener", "python3", "-c", CALLS) == ""
            if time.time() > end:
                break
            time.sleep(5)
        assert "rosie" in robot.run("talker", "rosparam", "get", "/robot/name")
        before = number(robot)
    until(lambda: robot.ready("bound"), "the node on the machine that was cut off", 120, every=1)
    until(
        lambda: len(robot.every_pod("ros-master")) == 1, "the end of the old master", 120, every=1
    )
    assert "number" in robot.run("listener", "sh", "-c", HEARS.replace("chatter", "bound"))
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

"""The readiness probe against real rospy and roscpp nodes and a real roscore."""

from __future__ import annotations

import signal
import subprocess

import pytest

MASTER = ("/bin/sh", "/rigel-k8s/ready.sh", "master")
pytestmark = pytest.mark.cluster

RELAY = ("rosrun", "topic_tools", "relay", "/in", "/out", "__name:=relay")
TALKER = """#!/usr/bin/env python
import sys
import rospy
from std_msgs.msg import String
rospy.init_node(sys.argv[1], anonymous="--anonymous" in sys.argv)
publisher = rospy.Publisher(sys.argv[1] + "_topic", String, queue_size=1)
rate = rospy.Rate(10)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rate.sleep()
"""
FILES = {"/talker.py": TALKER}
EXEC = ("/bin/sh", "/rigel-k8s/exec.sh")
THREE = "/talker.py one & /talker.py two & /talker.py three & wait"
#: Goes on when the master shuts its node down.
STUBBORN = ("bash", "-c", "/talker.py talker; exec sleep 1000")


def test_fixed_name(pods):
    """A rospy node with a fixed name is ready once it is registered from this pod."""
    pods.rosmaster()
    pod = pods.node("talker", "/talker.py", "talker", files=FILES)
    assert pod.probe().stdout == "ready: /talker\n"


def test_anonymous_name(pods):
    """A node whose name nobody knows beforehand is found by its address."""
    pods.rosmaster()
    pods.node("other", "/talker.py", "other", files=FILES)
    pod = pods.node("talker", "/talker.py", "talker", "--anonymous", files=FILES)
    line = pod.probe().stdout
    assert line.startswith("ready: /talker_")
    assert "/other" not in line


def test_roscpp(pods):
    """A roscpp node is ready too."""
    pods.rosmaster()
    pod = pods.node("relay", *RELAY)
    assert pod.probe().stdout == "ready: /relay\n"


def test_several_nodes(pods, eventually):
    """Every node of a pod counts: all of them are found, and one that hangs makes it unready."""
    pods.rosmaster()
    pod = pods.node("three", "bash", "-c", THREE, files=FILES)
    eventually(lambda: pod.probe().stdout.count("/") == 3, "all three nodes found")
    pod.signal("python /talker.py two", signal.SIGSTOP)
    done = pod.probe()
    assert done.returncode == 1
    assert done.stdout.startswith("/two (http://")
    assert "does not answer: timed out" in done.stdout


@pytest.mark.parametrize("command", [("/talker.py", "talker"), RELAY], ids=["rospy", "roscpp"])
def test_stopped_process(pods, command):
    """A stopped process turns its pod unready, and ready again when it goes on."""
    pods.rosmaster()
    pod = pods.node("node", *command, files=FILES)
    mark = {"/talker.py": "python /talker.py", "rosrun": "topic_tools/relay"}[command[0]]
    pod.signal(mark, signal.SIGSTOP)
    done = pod.probe()
    assert done.returncode == 1
    assert "does not answer: timed out" in done.stdout
    pod.signal(mark, signal.SIGCONT)
    assert pod.probe().returncode == 0


def test_master_restarted(pods):
    """A node that the new master does not know turns unready, and the line says why."""
    master = pods.rosmaster()
    pod = pods.node("talker", "/talker.py", "talker", files=FILES)
    master.kill()
    gone = pod.probe()
    assert gone.returncode == 1
    assert f"the ROS master at {pods.master_uri} cannot be reached" in gone.stdout
    assert "/talker" in gone.stdout
    pods.answering(pods.start("ros-master-2", "roscore", address=master.address))
    orphan = pod.probe()
    assert orphan.returncode == 1
    assert orphan.stdout.startswith("/talker (http://")
    assert "is an orphan" in orphan.stdout
    assert "restart this pod" in orphan.stdout


def test_name_taken(pods):
    """A node that was shut down by a namesake turns unready; the namesake's pod is ready."""
    pods.rosmaster()
    first = pods.node("first", *STUBBORN, files=FILES)
    second = pods.node("second", "/talker.py", "talker", files=FILES)
    assert first.probe().returncode == 1
    assert second.probe().stdout == "ready: /talker\n"


def test_crashed_node(pods, eventually):
    """A node that died without a word, one of several, makes its pod unready."""
    pods.rosmaster()
    pod = pods.node("three", "bash", "-c", THREE, files=FILES)
    eventually(lambda: pod.probe().stdout.count("/") == 3, "all three nodes found")
    pod.signal("python /talker.py two", signal.SIGKILL)
    eventually(lambda: not pod.pids("python /talker.py two"), "the node has ended")
    assert "/two" in pod.probe().stdout
    assert "has crashed" in pod.probe().stdout


def nodes(master) -> str:
    """The names that the master knows, with the ends that nobody knows beforehand."""
    return str(master.exec(*EXEC, "rosnode", "list").stdout)


@pytest.mark.parametrize("left", [False, True], ids=["execd", "left-in-the-background"])
def test_a_tool_that_was_killed(pods, eventually, left):
    """What `rigel exec` starts is none of the pod's nodes, not even registered and dead."""
    master = pods.rosmaster()
    pod = pods.node("talker", "/talker.py", "talker", files=FILES)
    tool = "rostopic hz /talker_topic"
    words = ("bash", "-c", f"{tool} & sleep 0.1") if left else tool.split()
    with subprocess.Popen(pod.entering(*EXEC, *words), stdout=subprocess.DEVNULL):
        eventually(lambda: "/rostopic_" in nodes(master), "the tool is registered")
        assert pod.probe().stdout == "ready: /talker\n"
        pod.signal("rostopic hz", signal.SIGKILL)
        eventually(lambda: not pod.pids("rostopic hz"), "the tool is dead")
    assert "/rostopic_" in nodes(master), "it was to stay registered"
    assert pod.probe().stdout == "ready: /talker\n"


def test_stopped_on_purpose(pods, eventually):
    """One of several that `rosnode kill` has ended leaves a ready pod."""
    master = pods.rosmaster()
    pod = pods.node("three", "bash", "-c", THREE, files=FILES)
    eventually(lambda: pod.probe().stdout.count("/") == 3, "all three nodes found")
    assert "killed" in master.exec(*EXEC, "rosnode", "kill", "/two").stdout
    eventually(lambda: not pod.pids("python /talker.py two"), "the node has ended")
    assert pod.probe().stdout == "ready: /one, /three\n"


def test_other_user(pods):
    """A node of another user than the probe's is found by its port."""
    pods.rosmaster()
    command = ("setpriv", "--reuid=1000", "--regid=1000", "--clear-groups", "/talker.py", "talker")
    pod = pods.node("talker", *command, files=FILES, env={"HOME": "/tmp"})
    as_user = ("setpriv", "--reuid=1001", "--regid=1001", "--clear-groups")
    done = pod.exec(*as_user, "/bin/sh", "/rigel-k8s/ready.sh", "node")
    assert done.stdout == "ready: /talker\n"


def test_no_python(pods):
    """An image without Python is told, with the way out, by an exit code of its own."""
    pod = pods.start("bare", "sleep", "60")
    pod.exec("sh", "-c", "rm -f /usr/bin/python*")
    done = pod.probe()
    assert done.returncode == 3
    assert "readiness.command or readiness.file" in done.stdout


def test_master_probe(pods):
    """A master is ready while it answers, whatever its nodes do."""
    master = pods.rosmaster()
    assert master.exec(*MASTER).stdout == "ready: ROS master at port 11311\n"
    master.signal("rosmaster", signal.SIGSTOP)
    done = master.exec(*MASTER)
    assert done.returncode == 1
    assert "the ROS master of this pod does not answer: timed out" in done.stdout


def test_a_bare_rosmaster_is_ready_without_them(pods):
    """Who runs rosmaster instead of roscore has no such parameters."""
    pods.master_uri = "http://localhost:11311"
    pods.answering(pods.start("ros-master", "rosmaster", "--core"))

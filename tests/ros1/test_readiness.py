"""The readiness probe against real rospy and roscpp nodes and a real roscore."""

from __future__ import annotations

import signal
import subprocess

import pytest

from .conftest import WAIT

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
#: Publishes one topic at once and another one when it gets SIGUSR1.
LATE = """#!/usr/bin/env python
import signal
import rospy
from std_msgs.msg import String
rospy.init_node("late")
early = rospy.Publisher("early", String, queue_size=1)
print("early is registered")
kept = []
signal.signal(signal.SIGUSR1, lambda *_: kept.append(rospy.Publisher("late", String, queue_size=1)))
while not rospy.is_shutdown():
    signal.pause()
"""
FILES = {"/talker.py": TALKER}
EXEC = ("/bin/sh", "/rigel-k8s/exec.sh")
THREE = "/talker.py one & /talker.py two & /talker.py three & wait"
#: Goes on when the master shuts its node down.
STUBBORN = ("bash", "-c", "/talker.py talker; exec sleep 1000")
KEPT = "/tmp/.rigel-k8s-nodes"


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


def test_starting(pods, eventually):
    """--wait notices a node that starts late, in one process."""
    pods.rosmaster()
    late = "until test -e /tmp/asked; do sleep 0.1; done; sleep 2; exec /talker.py talker"
    pod = pods.start("talker", "bash", "-c", late, files=FILES)
    at_once = pod.probe()
    assert at_once.returncode == 1
    assert "no process of this container listens yet" in at_once.stdout
    pod.exec("touch", "/tmp/asked")
    assert pod.probe(*WAIT).stdout == "ready: /talker\n"


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


def test_registered_by_halves(pods, eventually):
    """A node that told a new master one topic but not its others is an orphan still."""
    master = pods.rosmaster()
    pod = pods.node("talker", "/late.py", files={"/late.py": LATE})
    eventually(lambda: "early is registered" in pod.log(), "the first topic is registered")
    master.kill()
    pods.answering(pods.start("ros-master-2", "roscore", address=master.address))
    pod.signal("late.py", signal.SIGUSR1)
    other = pods.node("relay", *RELAY)
    eventually(lambda: pods.is_registered(other, "/late"), "the node is registered again")
    done = pod.probe()
    assert done.returncode == 1
    assert "does not have its /early" in done.stdout


def test_master_that_remembers(pods):
    """A master that got its registrations back, though another run, has no orphans."""
    pods.rosmaster()
    pod = pods.node("talker", "/talker.py", "talker", files=FILES)
    done = pod.exec(*EXEC, "rosparam", "set", "/run_id", "another")
    assert done.returncode == 0, done.stdout
    assert pod.probe().returncode == 0


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


def test_a_tool_makes_nothing_ready(pods, eventually):
    """While the pod's own node has not started, a visitor's does not stand for it."""
    master = pods.rosmaster()
    pod = pods.start("talker", "sleep", "1000", files=FILES)
    with subprocess.Popen(pod.entering(*EXEC, "/talker.py", "visitor")):
        eventually(lambda: pods.is_registered(master, "/visitor"), "the visitor is registered")
        assert "no process of this container listens yet" in pod.probe().stdout
        pod.signal("python /talker.py", signal.SIGKILL)


def test_stopped_on_purpose(pods, eventually):
    """One of several that `rosnode kill` has ended leaves a ready pod."""
    master = pods.rosmaster()
    pod = pods.node("three", "bash", "-c", THREE, files=FILES)
    eventually(lambda: pod.probe().stdout.count("/") == 3, "all three nodes found")
    assert "killed" in master.exec(*EXEC, "rosnode", "kill", "/two").stdout
    eventually(lambda: not pod.pids("python /talker.py two"), "the node has ended")
    assert pod.probe().stdout == "ready: /one, /three\n"


def test_restarted_by_a_shell(pods, eventually):
    """A node that its shell starts again is ready again, at its new port."""
    pods.rosmaster()
    loop = "while true; do /talker.py talker; sleep 0.1; done"
    pod = pods.node("loop", "bash", "-c", loop, files=FILES)
    old = pod.pids("talker.py talker")
    pod.signal("python /talker.py talker", signal.SIGKILL)
    eventually(lambda: set(pod.pids("python /talker.py")) - set(old), "another process")
    assert pod.probe(*WAIT).returncode == 0


def test_shared_address(pods):
    """Pods that share an address (host networking) answer for their own nodes only."""
    pods.rosmaster()
    first = pods.node("first", "/talker.py", "first", files=FILES)
    second = pods.node("second", "/talker.py", "second", beside=first, files=FILES)
    assert first.probe().stdout == "ready: /first\n"
    assert second.probe().stdout == "ready: /second\n"
    idle = pods.start("idle", "sleep", "60", beside=first)
    assert idle.probe().returncode == 1


def test_no_place_to_write(pods):
    """A container that can write nowhere is probed all the same."""
    pods.rosmaster()
    pod = pods.node("talker", "/talker.py", "talker", files=FILES)
    pod.exec("mount", "-t", "tmpfs", "-o", "ro", "tmpfs", "/tmp")
    pod.exec("mount", "-t", "tmpfs", "-o", "ro", "tmpfs", "/dev/shm")
    assert pod.probe().stdout == "ready: /talker\n"


def test_other_user(pods):
    """A node of another user than the probe's is found by its port."""
    pods.rosmaster()
    command = ("setpriv", "--reuid=1000", "--regid=1000", "--clear-groups", "/talker.py", "talker")
    pod = pods.node("talker", *command, files=FILES, env={"HOME": "/tmp"})
    as_user = ("setpriv", "--reuid=1001", "--regid=1001", "--clear-groups")
    done = pod.exec(*as_user, "/bin/sh", "/rigel-k8s/ready.sh", "node")
    assert done.stdout == "ready: /talker\n"


def test_old_container(pods):
    """What a probe kept is of no use to the container's next life."""
    pods.rosmaster()
    pod = pods.node("talker", "/talker.py", "talker", files=FILES)
    kept = pod.exec("cat", "/tmp/.rigel-k8s-nodes").stdout
    again = pods.node("again", "/talker.py", "other", files={**FILES, KEPT: kept})
    assert again.probe().stdout == "ready: /other\n"


def test_no_master_uri(pods):
    """Without ROS_MASTER_URI the line says so."""
    pods.master_uri = ""
    pod = pods.start("talker", "python3", "-m", "http.server", entrypoint=False)
    done = pod.probe("--wait", "3")
    assert done.returncode == 1
    assert done.stdout == "ROS_MASTER_URI is not set in this container\n"


def test_no_python(pods):
    """An image without Python is told, with the way out, by an exit code of its own."""
    pod = pods.start("bare", "sleep", "60")
    pod.exec("sh", "-c", "rm -f /usr/bin/python*")
    done = pod.probe()
    assert done.returncode == 3
    assert "readiness.command or readiness.file" in done.stdout


@pytest.mark.parametrize(
    "words", [(), ("nod",), ("node", "--wait"), ("master", "--components", "/a")]
)
def test_wrong_arguments(pods, words):
    """Wrong arguments are neither ready nor not ready."""
    pod = pods.start("bare", "sleep", "60")
    assert pod.exec("/bin/sh", "/rigel-k8s/ready.sh", *words).returncode == 2


def test_master_probe(pods):
    """A master is ready while it answers, whatever its nodes do."""
    master = pods.rosmaster()
    assert master.exec(*MASTER).stdout == "ready: ROS master at port 11311\n"
    master.signal("rosmaster", signal.SIGSTOP)
    done = master.exec(*MASTER)
    assert done.returncode == 1
    assert "the ROS master of this pod does not answer: timed out" in done.stdout


def test_slow_name_service(pods, eventually):
    """A name service that hangs ends the probe in time, with a word about it."""
    silent = pods.start("silent", "sleep", "60")
    pods.master_uri = "http://ros-master:11311"
    resolver = {"/etc/resolv.conf": f"nameserver {silent.address}\noptions timeout:30\n"}
    pod = pods.start("talker", "python3", "-m", "http.server", files=resolver, entrypoint=False)
    eventually(lambda: "listens yet" not in pod.probe().stdout, "the server listens")
    done = pod.probe()
    assert done.returncode == 1
    assert "timed out after" in done.stdout


def test_a_starting_roscore_is_not_ready_before_its_parameters(pods, eventually):
    """Nodes start when roscore is ready, and may ask for /rosversion at once."""
    pods.master_uri = "http://localhost:11311"
    slow = "from rosmaster.main import rosmaster_main; rosmaster_main(['--core'])"
    master = pods.start("ros-master", "python3", "/roscore", files={"/roscore": slow})
    eventually(lambda: master.exec(*MASTER).returncode == 0, "an answer of its master")
    early = master.exec(*MASTER, "--wait", "4")
    assert (early.returncode, early.stdout) == (1, "roscore has not set /rosversion yet\n")
    assert master.exec(*EXEC, "rosparam", "set", "/rosversion", "1.16.0").returncode == 0
    pods.answering(master)


def test_a_bare_rosmaster_is_ready_without_them(pods):
    """Who runs rosmaster instead of roscore has no such parameters."""
    pods.master_uri = "http://localhost:11311"
    pods.answering(pods.start("ros-master", "rosmaster", "--core"))

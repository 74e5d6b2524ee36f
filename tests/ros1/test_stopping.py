"""The preStop hook against real nodes, as process 1, under shells and under roslaunch."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from tests.support.until import until

pytestmark = pytest.mark.cluster

PROMISE = 3  # seconds from the hook's start until the master knows the node no more

TALKER = """#!/usr/bin/env python
import sys
import rospy
from std_msgs.msg import String
rospy.init_node("node")
publisher = rospy.Publisher("topic", String, queue_size=1)
rate = rospy.Rate(1)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rate.sleep()
"""
LAUNCH = """<launch>
<node pkg="demo" type="talker.py" name="node" respawn="true"/>
<node pkg="topic_tools" type="relay" name="relay" args="/a /b" respawn="true"/>
</launch>
"""
PACKAGE = """<package format="2"><name>demo</name><version>0.0.0</version>
<description>d</description><maintainer email="a@b.c">a</maintainer><license>x</license></package>
"""
FILES = {
    "/usr/share/demo/package.xml": PACKAGE,
    "/usr/share/demo/talker.py": TALKER,
    "/app.launch": LAUNCH,
}
RELAY = "/a /b __name:=node"
NODES = {"rospy": "/usr/share/demo/talker.py", "roscpp": f"/usr/lib/topic_tools/relay {RELAY}"}
ROSRUN = {"rospy": "rosrun demo talker.py", "roscpp": f"rosrun topic_tools relay {RELAY}"}
#: A program below roslaunch that counts its signals and needs a second to end.
COUNTING = {
    "/usr/share/demo/count.py": """#!/usr/bin/env python
import signal, time
signal.signal(signal.SIGINT, lambda *_: print("got SIGINT", flush=True))
print("counting", flush=True)
signal.pause()
time.sleep(1)
""",
    "/count.launch": """<launch>
<node pkg="demo" type="count.py" name="count" output="screen"/>
</launch>
""",
}
#: Says when it has seen /node at the master, and then how long after a line of input it was gone.
WATCH = f"""
import sys, time
sys.path.insert(0, "/rigel-k8s")
sys.dont_write_bytecode = True
from rosrpc import Api
known = lambda: Api("http://127.0.0.1:11311", time.time() + 9).call("lookupNode", "/node")[0] == "1"
assert known()
print("watching", flush=True)
sys.stdin.readline()
start = time.time()
while time.time() < start + {PROMISE}:
    if not known():
        print("gone after %.2f s" % (time.time() - start))
        sys.exit()
    time.sleep(0.01)
print("still there")
"""


@pytest.fixture
def cgroup():
    """A control group of the test's own, as another container has it."""
    tree = Path("/sys/fs/cgroup")
    root = tree if (tree / "cgroup.procs").exists() else tree / "pids"
    group = root / f"rigel-test-{os.getpid()}"
    group.mkdir()
    yield group
    for pid in (group / "cgroup.procs").read_text().split():
        with suppress(ProcessLookupError):
            os.kill(int(pid), signal.SIGKILL)
    while (group / "cgroup.procs").read_text():
        time.sleep(0.05)
    group.rmdir()


def terminated(master, pod):
    """End a pod as the kubelet does; return how the master saw /node go and the seconds it took."""
    with subprocess.Popen(
        master.entering("python3", "-c", WATCH),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as watching:
        assert watching.stdout.readline() == "watching\n"
        watching.stdin.write("\n")
        watching.stdin.flush()
        took = pod.terminate(grace=20)
        said = watching.communicate()[0].strip()
    sys.stdout.write(f"{said}, container ended after {took:.2f} s\n")
    return said, took


COMMANDS = {
    "first": "exec {node}",
    "rosrun": "exec {rosrun}",
    "shell": "{node}; true",
    "background": "{node} & wait",
    "deaf-shell": "trap '' TERM; {node}; true",
    "two-shells": "nohup sh -c '{node}; true'; true",
}
#: Each command with each client library once, and each shell with most of them; the rest is slow.
DAILY = {
    *(("bash", "first", "rospy"), ("sh", "first", "roscpp"), ("bash", "rosrun", "roscpp")),
    *(("sh", "rosrun", "rospy"), ("sh", "shell", "rospy"), ("bash", "shell", "roscpp")),
    *(("bash", "background", "rospy"), ("sh", "background", "roscpp")),
    *(("sh", "deaf-shell", "roscpp"), ("bash", "two-shells", "rospy")),
}


@pytest.mark.parametrize(
    ("shell", "command", "client"),
    [
        pytest.param(*case, marks=[] if case in DAILY else pytest.mark.slow, id="-".join(case))
        for case in itertools.product(("bash", "sh"), COMMANDS, NODES)
    ],
)
def test_unregistered(pods, shell, command, client):
    """Whatever process 1 is, the node is unregistered in time and the container ends by itself."""
    master = pods.rosmaster()
    command = COMMANDS[command].format(node=NODES[client], rosrun=ROSRUN[client])
    pod = pods.node("node", shell, "-c", command, files=FILES)
    said, took = terminated(master, pod)
    assert said.startswith("gone")
    assert took < 20, "the container had to be killed"


@pytest.mark.parametrize("command", ["exec {}", "{}; true"], ids=["first", "shell"])
def test_roslaunch(pods, eventually, command):
    """What roslaunch keeps alive is unregistered in time and not started again."""
    master = pods.rosmaster()
    pod = pods.node("node", "bash", "-c", command.format("roslaunch /app.launch"), files=FILES)
    eventually(lambda: pod.probe().stdout == "ready: /node, /relay\n", "both nodes ready")
    said, took = terminated(master, pod)
    assert said.startswith("gone")
    assert not pods.is_registered(master, "/relay")
    assert took < 20, "the container had to be killed"


def test_launched_once(pods, eventually):
    """What roslaunch started gets one SIGINT, from roslaunch: a second one would cut it short."""
    pods.roscore()
    pod = pods.start("counts", "roslaunch", "/count.launch", files={**FILES, **COUNTING})
    eventually(lambda: "counting" in pod.log(), "the node runs")
    pod.terminate(grace=20)
    assert pod.log().count("got SIGINT") == 1


def test_master(pods, eventually):
    """A roscore that gets the hook ends in order, too."""
    master = pods.roscore()
    eventually(lambda: "started core service [/rosout]" in master.log(), "roscore is complete")
    assert master.terminate(grace=20) < 20
    assert "shutting down processing monitor complete" in master.log()


def test_spares_others(pods, eventually, cgroup):
    """With processes of other containers in sight (hostPID) only this container's are stopped."""
    pod = pods.start("own", "bash", "/run.sh", files={"/run.sh": "sleep 961 & sleep 962 & wait\n"})
    eventually(lambda: pod.pids("sleep 961") and pod.pids("sleep 962"), "both run")
    (cgroup / "cgroup.procs").write_text(str(pod.pids("sleep 961")[0]))
    pod.exec("/bin/sh", "/rigel-k8s/stop.sh", "4")
    eventually(lambda: not pod.pids("sleep 962"), "the container's own process has ended")
    assert pod.pids("sleep 961")


#: Logs, and says when it has ended.
LOGGING = """
import sys, rospy
rospy.init_node(sys.argv[1])
while not rospy.is_shutdown():
    rospy.loginfo("busy")
    rospy.rostime.wallsleep(0.05)
print("ended " + sys.argv[1], file=sys.stderr)
"""


@pytest.mark.parametrize("gate", [True, False])
def test_no_line_of_a_log_waits_for_the_master(pods, *, gate):
    """SIGINT in a call to the master would meet rospy's own lock in the same thread, for ever.

    The master is frozen while SIGINT arrives: a node that calls it is in a call then. Nobody
    listens to /rosout by then: rospy locks what it sends to a subscriber, too, which SIGINT may
    meet as well, whatever the master does.
    """
    master, roscore = pods.gated() if gate else [pods.roscore()] * 2
    program = "rigel_gate" if gate else "rosmaster"
    names = [f"n{number}" for number in range(4)]
    start = f"for n in {' '.join(names)}; do python3 -c '{LOGGING}' $n >/dev/null & done; wait"
    pod = pods.start("logging", "sh", "-c", start)
    for name in names:
        until(lambda name=name: pods.is_registered(pod, f"/{name}"), name)
    time.sleep(2)
    roscore.signal("roscore.py", signal.SIGSTOP)  # it would start rosout again
    roscore.signal("rosout/rosout", signal.SIGKILL)
    time.sleep(2)  # the nodes' next lines find their connections closed
    master.signal(program, signal.SIGSTOP)
    time.sleep(1)
    for pid in set(pod.pids("init_node")) - {pod.init}:
        os.kill(pid, signal.SIGINT)
    time.sleep(1)
    master.signal(program, signal.SIGCONT)
    until(
        lambda: pod.log().count("ended n") == len(names), "the end of all", 40, last_words=pod.log
    )

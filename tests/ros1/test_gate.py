"""The gate in front of a real roscore, with rospy and roscpp: nobody notices an update."""

from __future__ import annotations

import os
import signal
import sys
import time

import pytest

from rigel_k8s.objects.pods import MASTER_PORT, ROSCORE_PORT
from tests.support.until import until

from .gated import LISTENER, TALKER, hands_over, heard, listener, ready, talker, versions

pytestmark = pytest.mark.cluster

SERVER = """
import sys, rospy, std_srvs.srv, std_msgs.msg
rospy.init_node("server")
answer = lambda _: std_srvs.srv.TriggerResponse(True, sys.argv[1])
rospy.Service("/ask", std_srvs.srv.Trigger, answer)
latched = rospy.Publisher("/map", std_msgs.msg.String, queue_size=1, latch=True)
latched.publish(sys.argv[1] + " 0")
rospy.spin()
"""
CLIENT = """
import rospy, std_srvs.srv
rospy.init_node("client")
ask = rospy.ServiceProxy("/ask", std_srvs.srv.Trigger)
rate = rospy.Rate(10)
while not rospy.is_shutdown():
    for _ in range(2):
        try:
            print("answered by " + ask().message)
            break
        except (rospy.ServiceException, rospy.ROSException) as error:
            print("failed: %s" % error)
    else:
        print("failed twice")
    rate.sleep()
"""
#: Prints what the master at a port knows of topics, services and parameters, sorted, without
#: roscore's own.
STATE = """
import sys, xmlrpc.client
master = xmlrpc.client.ServerProxy("http://127.0.0.1:" + sys.argv[1])
for part in master.getSystemState("/test")[2]:
    for key, names in sorted(part):
        for name in sorted(set(names) - {"/rosout"}):
            print(key, name)
for name in sorted(master.getParamNames("/test")[2]):
    if name.startswith("/kept/"):
        print(name, master.getParam("/test", name)[2])
"""
#: Sets 50 parameters, one after the other.
REMEMBER = """
import xmlrpc.client
master = xmlrpc.client.ServerProxy("http://127.0.0.1:11311")
for number in range(50):
    master.setParam("/test", "/kept/n%d" % number, [number, "text %d" % number])
"""
#: A publisher of /rosout, a topic and two services of loggers for each of the 21 nodes; parameters.
STATE_LINES = 21 * 4 + 50
LAUNCH = """<launch>
  <node pkg="topic_tools" type="relay" name="left" args="/chatter /heard_left" respawn="true"/>
  <node pkg="topic_tools" type="relay" name="right" args="/chatter /heard_right"/>
</launch>
"""
RELAY = ("rosrun", "topic_tools", "relay", "/chatter", "/relayed", "__name:=relay")


@pytest.mark.timing
def test_a_talker_is_updated_without_a_gap(pods):
    """The newcomer waits, takes over when the old pod ends, and the listener hears both in turn."""
    pods.gated()
    old = talker(pods, "v1")
    assert "ready: /talker" in ready(old)
    ears = listener(pods)
    until(lambda: len(heard(ears)) > 5, "messages")
    new = talker(pods, "v2", late=1)
    assert "/talker waits to take over" in ready(new)
    assert set(versions(ears)) == {"v1"}
    old.terminate()
    until(lambda: "v2" in versions(ears), "messages of v2")
    until(lambda: "waits" not in ready(new), "a talker that has its name")
    found = heard(ears)
    order = [version for _, version, _ in found]
    assert order == sorted(order), "nothing of the old one after the new one"
    assert len(set(found)) == len(found)
    last = max(when for when, version, _ in found if version == "v1")
    first = min(when for when, version, _ in found if version == "v2")
    assert first - last < 1


def test_a_roscpp_node_is_updated(pods):
    """A relay subscribes and publishes: the new one hears nothing before it has the name."""
    pods.gated()
    ready(talker(pods, "v1"))
    env = hands_over(pods, "relay")
    old = pods.start("relay-1", *RELAY, env=env)
    ready(old)
    ears = listener(pods, topic="/relayed")
    until(lambda: heard(ears), "relayed messages")
    new = pods.start("relay-2", *RELAY, env=env)
    assert "waits to take over" in ready(new)
    old.terminate()
    count = len(heard(ears))
    until(lambda: len(heard(ears)) > count + 10, "messages of the new relay")
    found = heard(ears)
    assert len({number for _, _, number in found}) == len(found), "no message came twice"


def test_all_nodes_of_a_launch_file_are_updated(pods):
    """Each of a pod's names changes hands; what roslaunch starts again meanwhile is no harm."""
    pods.gated()
    ready(talker(pods, "v1"))
    more = {"env": hands_over(pods, "relays"), "files": {"/relays.launch": LAUNCH}}
    command = ("roslaunch", "--wait", "/relays.launch")
    old = pods.start("relays-1", *command, **more)
    ready(old)
    ears = [listener(pods, f"ear{side}", f"/heard_{side}") for side in ("left", "right")]
    new = pods.start("relays-2", *command, **more)
    told = until(lambda: (line := ready(new)).count("waits") == 2 and line, "both to wait")
    assert "/left waits to take over" in told
    old.terminate()
    for ear in ears:
        count = len(heard(ear))
        until(lambda ear=ear, count=count: len(heard(ear)) > count + 10, "messages of the new one")
    assert ready(new) == "ready: /left, /right\n"


def test_services_and_latched_topics_change_hands(pods):
    """No call at 10 Hz fails twice; the new map reaches old subscribers, and only it new ones."""
    pods.gated()
    env = hands_over(pods, "server")
    old = pods.start("server-1", "python3", "-c", SERVER, "v1", env=env)
    ready(old)
    eyes = listener(pods, topic="/map")
    client = pods.node("client", "python3", "-c", CLIENT)
    until(lambda: "answered by v1" in client.log() and versions(eyes) == ["v1"], "answers")
    new = pods.start("server-2", "python3", "-c", SERVER, "v2", env=env)
    ready(new)
    assert "v2" not in client.log()
    old.terminate()
    until(lambda: "answered by v2" in client.log(), "answers of v2")
    until(lambda: versions(eyes) == ["v1", "v2"], "the new map")
    late = listener(pods, "late", "/map")
    until(lambda: versions(late) == ["v2"], "the new map, for one that comes later")
    assert "failed twice" not in client.log()


@pytest.mark.slow  # KILLS=1000 takes half an hour; once in each run: the test above
def test_roscore_is_killed_again_and_again(pods):
    """With 20 nodes and 50 parameters nothing is missing afterwards; `-s` shows the times."""
    gate, roscore = pods.gated()
    nodes = " ".join(f"n{number}" for number in range(20))
    start = f"for n in {nodes}; do python3 -c '{LISTENER}' $n /chatter & done; wait"
    pods.start("many", "sh", "-c", start)
    pods.start("talker", "python3", "-c", TALKER, "v1", "0")
    gate.exec("python3", "-c", REMEMBER)
    look = ("python3", "-c", STATE, str(ROSCORE_PORT))
    until(lambda: len(gate.exec(*look).stdout.splitlines()) == STATE_LINES, "all nodes", 120)
    everything = gate.exec(*look).stdout
    times = []
    for _ in range(int(os.environ.get("KILLS", "20"))):
        roscore.kill()
        roscore = pods.behind(gate)
        until(lambda: gate.exec(*look).returncode == 0, "an answer of the master", every=0.02)
        began = time.monotonic()
        until(
            lambda: gate.exec(*look).stdout == everything,
            "everything",
            every=0.05,
            last_words=lambda: gate.exec(*look).stdout + gate.log(),
        )
        times.append(time.monotonic() - began)
    times.sort()
    sys.stdout.write(
        f"{len(times)} kills; seconds from the new master's first answer until all is back:"
        f" half of the times within {times[len(times) // 2]:.2f}, the longest"
        f" {', '.join(f'{one:.2f}' for one in times[-5:])}\n"
    )


def test_the_gate_may_be_killed(pods):
    """Its worker is killed again and again while nodes start: each is registered in the end.

    A call of a node is cut off once at most, since xmlrpc.client makes it twice.
    """
    gate, _ = pods.gated()
    command = ("python3", "-c", LISTENER)
    names = [f"listener_{number}" for number in range(3)]
    started = [pods.start(name.replace("_", "-"), *command, name, "/chatter") for name in names]
    started.append(talker(pods, "v1"))
    for _ in range(8):
        kill_worker(gate)
        pods.answering(gate)
        time.sleep(0.1)
    for pod in started:
        ready(pod)
    look = ("python3", "-c", STATE, str(ROSCORE_PORT))
    for pod in started[:3]:
        until(
            lambda pod=pod: heard(pod),
            "messages",
            last_words=lambda pod=pod: gate.exec(*look).stdout + pod.log() + gate.log(),
        )


def kill_worker(gate):
    for worker in set(gate.pids("rigel_gate")) - {gate.init}:
        os.kill(worker, signal.SIGKILL)


def test_a_node_that_could_not_ask_the_gate_hears_after_its_return(pods):
    """rospy asks for a parameter when it connects, and drops the connection if that fails."""
    gate, _ = pods.gated()
    ears = listener(pods)
    refused = ("OUTPUT", "-p", "tcp", "--dport", str(MASTER_PORT), "-j", "REJECT")
    refused += ("--reject-with", "tcp-reset")
    pods.iptables(ears, "-I", *refused)
    ready(talker(pods, "v1"))
    log = ("/bin/sh", "-c", "cat ~/.ros/log/*.log")
    until(lambda: "removing connection to" in ears.exec(*log).stdout, "a dropped connection")
    pods.iptables(ears, "-D", *refused)
    kill_worker(gate)
    until(lambda: heard(ears), "messages")


#: Whether a port of a host takes connections.
KNOCK = """
import socket, sys
try:
    socket.create_connection((sys.argv[1], int(sys.argv[2])), 3).close()
    print("open")
except OSError as error:
    print(error)
"""


SHOUTER = """
import rospy
rospy.init_node("shouter")
while not rospy.is_shutdown():
    rospy.loginfo("here")
    rospy.sleep(0.2)
"""


def test_roscore_is_reached_through_the_gate_only(pods):
    """Its port is the loopback's; what /rosout repeats reaches other pods all the same."""
    gate, _ = pods.gated()
    watcher = listener(pods)
    knock = ("/rigel-k8s/exec.sh", "python3", "-c", KNOCK, gate.address)
    assert watcher.exec("/bin/sh", *knock, str(MASTER_PORT)).stdout.strip() == "open"
    assert "refused" in watcher.exec("/bin/sh", *knock, str(ROSCORE_PORT)).stdout
    heard_log = (
        "/rigel-k8s/exec.sh",
        "timeout",
        "120",
        "rostopic",
        "echo",
        "-n1",
        "/rosout_agg/name",
    )
    shouter = pods.node("shouter", "python3", "-c", SHOUTER)
    assert "/shouter" in watcher.exec("/bin/sh", *heard_log).stdout, shouter.log()

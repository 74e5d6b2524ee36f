"""What an update is for actions and subscribers: the gate in front of a real roscore."""

from __future__ import annotations

import re
import sys

import pytest

from tests.support.until import until

from .gated import LISTENER, hands_over, heard, ready, talker

pytestmark = pytest.mark.cluster

#: Works on a goal as many seconds as it says; the result is the version.
ACTION_SERVER = """
import sys, time, rospy, actionlib, actionlib.msg
version = int(sys.argv[1])
def execute(goal):
    for _ in range(goal.goal * 10):
        server.publish_feedback(actionlib.msg.TestFeedback(version))
        time.sleep(0.1)
    server.set_succeeded(actionlib.msg.TestResult(version))
rospy.init_node("arm")
server = actionlib.SimpleActionServer("move", actionlib.msg.TestAction, execute, auto_start=False)
def end():
    if server.is_active():
        server.set_aborted(text="the server ends")
        time.sleep(0.5)  # rospy drops what it has not sent yet when this hook ends
if sys.argv[2:]:
    rospy.on_shutdown(end)
server.start()
rospy.spin()
"""
#: One goal of ten minutes, then goals that end at once, each with a limit of five seconds.
ACTION_CLIENT = """
import rospy, actionlib, actionlib.msg
rospy.init_node("client")
client = actionlib.SimpleActionClient("move", actionlib.msg.TestAction)
client.wait_for_server()
NAMES = {v: k for k, v in vars(actionlib.GoalStatus).items() if type(v) is int and k.isupper()}
def hear(feedback):
    print("feedback of v%d" % feedback.feedback)
def ask(seconds, limit):
    client.send_goal(actionlib.msg.TestGoal(seconds), feedback_cb=hear)
    if client.wait_for_result(rospy.Duration(limit)):
        result = client.get_result()
        version = "v%d" % result.result if result and result.result else "no version"
        print("%s: %s" % (NAMES[client.get_state()], version))
    else:
        print("no answer")
ask(600, 500)
while not rospy.is_shutdown():
    ask(0, 5)
    rospy.sleep(0.2)
"""


def test_a_goal_ends_with_its_action_server_and_the_next_one_succeeds(pods):
    """The client is told that the goal is lost; its next goals need no new client."""
    pods.gated()
    env = hands_over(pods, "arm")
    ready(old := pods.start("arm-1", "python3", "-c", ACTION_SERVER, "1", env=env))
    client = pods.node("client", "python3", "-c", ACTION_CLIENT)
    until(lambda: "feedback of v1" in client.log(), "feedback")
    new = pods.start("arm-2", "python3", "-c", ACTION_SERVER, "2", env=env)
    assert "/arm waits to take over" in ready(new)
    assert "LOST" not in client.log()
    old.terminate(grace=10)
    until(lambda: "SUCCEEDED: v2" in client.log(), "a result of v2", 120, last_words=client.log)
    ends = re.findall(r"^[A-Z]+: (?:v\d|no version)$", client.log(), re.MULTILINE)
    assert ends[0] == "LOST: no version"
    assert not [line for line in ends if line.endswith(": v1")]
    since = ends[ends.index("SUCCEEDED: v2") :]
    assert set(since) == {"SUCCEEDED: v2"}


def test_an_action_server_may_abort_its_goal_when_it_ends(pods):
    """Its client is told so by the server that ends, or that the goal is lost; it never waits."""
    pods.gated()
    env = hands_over(pods, "arm")
    ready(old := pods.start("arm-1", "python3", "-c", ACTION_SERVER, "1", "aborts", env=env))
    client = pods.node("client", "python3", "-c", ACTION_CLIENT)
    until(lambda: "feedback of v1" in client.log(), "feedback")
    ready(pods.start("arm-2", "python3", "-c", ACTION_SERVER, "2", "aborts", env=env))
    old.terminate(grace=10)
    ends = until(
        lambda: re.findall(r"^(\w+): no version", client.log(), re.MULTILINE),
        "an end",
        last_words=client.log,
    )
    sys.stdout.write(f"the goal's end: {ends[0]}\n")
    assert ends[0] in ("ABORTED", "LOST")


@pytest.mark.parametrize("rate", [20, 100])
def test_a_subscriber_is_updated(pods, rate):
    """The new one goes on in order where the old one has ended; `-s` shows how much both miss."""
    pods.gated()
    ready(talker(pods, "v1", rate=rate))
    env = hands_over(pods, "ears")
    command = ("python3", "-c", LISTENER, "ears", "/chatter")
    ready(old := pods.start("ears-1", *command, env=env))
    until(lambda: heard(old), "messages to the old one")
    ready(new := pods.start("ears-2", *command, env=env))
    assert not heard(new)
    old.terminate()
    until(lambda: len(heard(new)) > 2 * rate, "messages to the new one")
    first, last = ([number for _, _, number in heard(pod)] for pod in (old, new))
    assert first == sorted(set(first))
    assert last == sorted(set(last))
    missed, twice = last[0] - first[-1] - 1, len(set(first) & set(last))
    sys.stdout.write(f"{rate} Hz: {max(missed, 0)} messages missed, {twice} heard by both\n")
    assert last[0] > first[0]
    assert last[-1] > first[-1]

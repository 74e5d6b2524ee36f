"""The example's talker and listener, and the base image that they stand on, on real ROS."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.cluster

EXAMPLE = Path(__file__).parents[2] / "examples" / "ros1-talker-listener"
ROS = "/opt/ros/noetic"
EXEC = ("/bin/sh", "/rigel-k8s/exec.sh")


def package() -> dict[str, str]:
    """The example's package where its Dockerfile puts it."""
    source = EXAMPLE / "talker_listener"
    return {
        f"/usr/share/talker_listener/{path.relative_to(source)}": path.read_text()
        for path in source.rglob("*")
        if path.is_file() and path.suffix in (".py", ".xml")
    }


def numbers(log: str, nonce: str) -> list[int]:
    """The numbers that the listener has heard with a nonce, in order."""
    return [int(n) for n in re.findall(rf"I heard hello world {nonce} (\d+)\n", log)]


def shortest_time(log: str, count: int) -> float:
    """The shortest time in which the talker has logged so many messages, by its own clock."""
    times = [float(t) for t in re.findall(r"\[(\d+\.\d+)\]: hello world .*\n", log)]
    pairs = zip(times, times[count - 1 :], strict=False)
    return min((last - first for first, last in pairs), default=float("inf"))


def test_delivery(pods, eventually):
    """A nonce set while both run arrives at the listener, with consecutive numbers."""
    pods.roscore()
    talker = pods.node(
        "talker", "rosrun", "talker_listener", "talker.py", files=package(), env={"VERSION": "2"}
    )
    listener = pods.node("listener", "rosrun", "talker_listener", "listener.py", files=package())
    eventually(lambda: "talker version 2" in talker.log(), "the version")
    eventually(lambda: numbers(listener.log(), "none"), "a message before there is a nonce")
    done = talker.exec(*EXEC, "rosparam", "set", "/nonce", "n1e5")
    assert done.returncode == 0, done.stdout
    eventually(lambda: len(numbers(listener.log(), "n1e5")) > 10, "messages with the nonce")
    heard = numbers(listener.log(), "n1e5")
    assert heard == list(range(heard[0], heard[0] + len(heard)))
    assert numbers(listener.log(), "none"), "the nonce was no change"


def test_rate(pods, eventually):
    """The talker's private parameter sets how often it speaks."""
    pods.roscore()
    command = ("rosrun", "talker_listener", "talker.py", "_rate:=200")
    talker = pods.node("talker", *command, files=package())
    eventually(lambda: shortest_time(talker.log(), 20) < 1, "20 messages in a second, not 10")


def test_master_away(pods, eventually):
    """Both go on talking while the master is away."""
    master = pods.roscore()
    talker = pods.node("talker", "rosrun", "talker_listener", "talker.py", files=package())
    listener = pods.node("listener", "rosrun", "talker_listener", "listener.py", files=package())
    eventually(lambda: numbers(listener.log(), "none"), "a message")
    master.kill()
    before = len(numbers(listener.log(), "none"))
    eventually(lambda: len(numbers(listener.log(), "none")) > before + 20, "more messages")
    assert talker.alive()


@pytest.mark.parametrize("name", ["std_msgs", "rospy", "roscpp", "topic_tools", "rosgraph_msgs"])
def test_rospack(pods, name):
    """rospack finds the packages where the official image has them."""
    pods.master_uri = "http://localhost:11311"
    pod = pods.start("pod", "sleep", "60")
    assert pod.exec(*EXEC, "rospack", "find", name).stdout == f"{ROS}/share/{name}\n"


def test_tools(pods, eventually):
    """The command line tools of the official image work: distribution, messages, topics, nodes."""
    master = pods.roscore()
    expected = {
        ("rosversion", "-d"): "noetic\n",
        ("rosmsg", "show", "std_msgs/String"): "string data\n\n",
        ("rostopic", "list"): "/rosout\n/rosout_agg\n",
        ("rosnode", "list"): "/rosout\n",
        ("rosservice", "type", "/rosout/get_loggers"): "roscpp/GetLoggers\n",
        ("bash", "-c", f". {ROS}/setup.bash; roscd rospy; pwd"): f"{ROS}/share/rospy\n",
    }
    for command, said in expected.items():  # roscore answers before its /rosout has registered
        eventually(
            lambda command=command, said=said: master.exec(*EXEC, *command).stdout == said,
            " ".join(command),
        )

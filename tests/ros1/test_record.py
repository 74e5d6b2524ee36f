"""The recorder of `record` with the image's own rosbag: killed, stopped, limited, without it."""

from __future__ import annotations

import json
import signal
import time

import pytest

from tests.support.until import until

from .conftest import PATIENCE

pytestmark = pytest.mark.cluster

RECORD = ("/bin/sh", "/rigel-k8s/record.sh", "/bags")
TALKER = """#!/usr/bin/env python3
import time
import rospy
from std_msgs.msg import String
rospy.init_node("talker")
publisher = rospy.Publisher("/chatter", String, queue_size=10)
number = 0
while not rospy.is_shutdown():
    publisher.publish("%.3f %d " % (time.time(), number) + "x" * SIZE)
    number += 1
    time.sleep(0.05)
"""
#: Prints when a bag's last message was sent, how many it has, and how many are missing.
READ = """
import sys, rosbag
found = [m.data.split() for _, m, _ in rosbag.Bag(sys.argv[1]).read_messages(["/chatter"])]
sent, numbers = [float(words[0]) for words in found], [int(words[1]) for words in found]
print(sent[-1], len(found), numbers[-1] - numbers[0] + 1 - len(set(numbers)))
"""


def talk(pods, size=1):
    """Start a master and a talker."""
    pods.rosmaster()
    files = {"/talker.py": TALKER.replace("SIZE", str(size))}
    return pods.start("talker", "python3", "/talker.py", files=files)


def record(pods, split="300s", limit=2**30, before=""):
    """Start a recorder, in a pod whose folder of bags exists."""
    line = f"mkdir -p /bags; {before} exec {' '.join(RECORD)} run {split} {limit}"
    return pods.start("recorder", "sh", "-c", line)


def bags(pod):
    """The bags by their names."""
    done = pod.exec(*RECORD, "list")
    assert done.returncode == 0, done.stdout
    return {one["name"]: one for one in json.loads(done.stdout)}


def wait_for_states(pod, *states):
    """Wait until there are bags with these states, and return their names in that order."""

    def look():
        found = bags(pod)
        return found if sorted(b["state"] for b in found.values()) == sorted(states) else None

    found = until(look, f"bags: {states}", PATIENCE, last_words=lambda: f"{bags(pod)} {pod.log()}")
    return [next(n for n, b in found.items() if b["state"] == state) for state in states]


def wait_until_written(pod):
    """Wait until the recorder is ready and has messages, and return the bag's name."""
    until(lambda: pod.exec("test", "-e", "/tmp/rigel-k8s-recording").returncode == 0, "ready", 60)
    (name,) = wait_for_states(pod, "recording")
    until(lambda: bags(pod)[name]["size"] > 8192, "messages", 60, last_words=pod.log)
    return name


def read(pod, name):
    """(when its last message was sent, how many there are, how many are missing between them)."""
    done = pod.exec("python3", "-c", READ, f"/bags/{name}")
    assert done.returncode == 0, done.stdout
    last, count, missing = done.stdout.split()
    return float(last), int(count), int(missing)


def test_a_killed_recorder_loses_a_second(pods):
    """What was recorded until a second before the kill is readable after the next start."""
    talk(pods)
    again = f"until {' '.join(RECORD)} run 300s {2**30}; do sleep 1; done;"
    pod = record(pods, before=again)
    name = wait_until_written(pod)
    for word in ("record.py", "rosbag/record"):
        pod.signal(word, signal.SIGKILL)
    killed = time.time()
    repaired, _ = wait_for_states(pod, "repaired", "recording")
    assert repaired == name.replace(".bag", "-repaired.bag")
    last, count, missing = read(pod, repaired)
    assert killed - 1 < last < killed
    assert (count > 5, missing) == (True, 0)
    assert f"{name} was not closed and is being repaired" in pod.log()


def test_a_stopped_pod_closes_its_bag(pods):
    """The stop hook ends the recorder, and its bag is complete before the container ends."""
    talk(pods)
    pod = record(pods)
    name = wait_until_written(pod)
    pod.terminate()
    left = pod.output.parent / "upper" / "bags"
    assert [path.name for path in left.iterdir()] == [name]
    reader = pods.start("reader", "sleep", "60", files={"/bags/a.bag": (left / name).read_bytes()})
    _, count, missing = read(reader, "a.bag")
    assert (count > 5, missing) == (True, 0)


def test_the_limit_deletes_the_oldest(pods):
    """All bags together stay below the limit; the one that is written is never deleted."""
    talker = talk(pods, size=200_000)
    limit = 20 * 2**20
    pod = record(pods, str(4 * 2**20), limit)
    sizes = []

    def look():
        found = bags(pod)
        sizes.append(sum(one["size"] for one in found.values()))
        return pod.log().count("exceed the limit") >= 2 and found

    found = until(look, "two deleted bags", PATIENCE, last_words=pod.log)
    assert sum(one["state"] == "recording" for one in found.values()) <= 1
    assert len(found) >= 3
    assert max(sizes) < limit + 8 * 2**20  # of a second, and the one that is begun
    talker.kill()  # or the limit deletes the bag that is asked for below, and a new one begins
    until(lambda: sum(one["size"] for one in look().values()) < limit, "what is over the limit", 30)
    refused = pod.exec(*RECORD, "delete", wait_for_recording(pod))
    assert (refused.returncode, "is being written" in refused.stdout) == (1, True)
    closed = [name for name, one in bags(pod).items() if one["state"] == "closed"][-1]
    assert pod.exec(*RECORD, "delete", closed).returncode == 0
    assert closed not in bags(pod)


def wait_for_recording(pod):
    """Wait until a bag is being written."""
    look = lambda: [n for n, one in bags(pod).items() if one["state"] == "recording"]  # noqa: E731
    return until(look, "a bag that is being written", 30)[0]

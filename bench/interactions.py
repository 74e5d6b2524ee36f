"""Updates of ROS 1 subscribers, services, latched topics and action servers, by hand-over.

usage: python -m bench.interactions [--updates 20] [--late 0,5] [--strategies HandOver,Recreate]
                                    [--kinds subscriber,service,latched,action] [--context NAME]

Each kind is a release on two machines: a program that is updated, and one on the other machine that
notices it. The context is one of `rigel cluster`; left out, that of bench.updates is used.
"""

from __future__ import annotations

import argparse
import itertools
import re
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from statistics import median

import attrs

from bench.rollouts import Rollouts, find_cluster, numbers, until

SPACE = "bench-interactions"
#: The beginning of each updated program: it starts as late as a program that loads a model.
LATE = """
import os, sys, time
time.sleep(float(os.environ["LATE"]))
VERSION = os.environ["VERSION"]
import rospy, std_msgs.msg, std_srvs.srv
"""
#: The beginning of the programs that notice updates.
NOTICES = """
import sys, time, rospy, std_msgs.msg, std_srvs.srv
def say(*words):
    print("%.4f %s" % (time.time(), " ".join(map(str, words))))
    sys.stdout.flush()
"""
SOURCE = """
import rospy, std_msgs.msg
rospy.init_node("source")
publisher = rospy.Publisher("numbers", std_msgs.msg.UInt64, queue_size=100)
rate, number = rospy.Rate(RATE), 0
while not rospy.is_shutdown():
    publisher.publish(number)
    number += 1
    rate.sleep()
"""
#: The updated subscriber republishes what it received.
RELAY = (
    LATE
    + """
rospy.init_node("relay")
publisher = rospy.Publisher("relayed", std_msgs.msg.String, queue_size=100)
send = lambda m: publisher.publish("%s %d" % (VERSION, m.data))
rospy.Subscriber("numbers", std_msgs.msg.UInt64, send, tcp_nodelay=True)
rospy.spin()
"""
)
HEARS = (
    NOTICES
    + """
rospy.init_node("notices")
rospy.Subscriber("relayed", std_msgs.msg.String, lambda m: say(m.data), tcp_nodelay=True)
rospy.spin()
"""
)
SERVER = (
    LATE
    + """
rospy.init_node("server")
rospy.Service("ask", std_srvs.srv.Trigger, lambda _: std_srvs.srv.TriggerResponse(True, VERSION))
rospy.spin()
"""
)
#: Calls ten times per second, and again at once if that fails.
ASKS = (
    NOTICES
    + """
rospy.init_node("notices")
ask, rate, number = rospy.ServiceProxy("ask", std_srvs.srv.Trigger), rospy.Rate(10), 0
rospy.wait_for_service("ask")
while not rospy.is_shutdown():
    number += 1
    for left in (1, 0):
        try:
            say(ask().message, number)
            break
        except (rospy.ServiceException, rospy.ROSException):
            say("again" if left else "failed", number)
    rate.sleep()
"""
)
MAP = (
    LATE
    + """
rospy.init_node("server")
publisher = rospy.Publisher("map", std_msgs.msg.String, queue_size=1, latch=True)
publisher.publish(VERSION + " 0")
rospy.spin()
"""
)
SEES = (
    NOTICES
    + """
rospy.init_node("notices")
rospy.Subscriber("map", std_msgs.msg.String, lambda m: say(m.data))
rospy.spin()
"""
)
ACTION = (
    LATE
    + """
import actionlib, actionlib.msg
rospy.init_node("server")
def work(goal):
    for _ in range(20):
        time.sleep(0.1)
    server.set_succeeded(actionlib.msg.TestResult(goal.goal), VERSION)
server = actionlib.SimpleActionServer("work", actionlib.msg.TestAction, work, auto_start=False)
server.start()
rospy.spin()
"""
)
#: Always has a running goal of two seconds.
WANTS = (
    NOTICES
    + """
import actionlib, actionlib.msg
rospy.init_node("notices")
client, number = actionlib.SimpleActionClient("work", actionlib.msg.TestAction), 0
client.wait_for_server()
while not rospy.is_shutdown():
    number += 1
    client.send_goal(actionlib.msg.TestGoal(number))
    done = client.wait_for_result(rospy.Duration(6))
    if done and client.get_result() and client.get_result().result == number:
        say(client.get_goal_status_text(), number)
    else:
        say("lost", number)
"""
)
LINE = re.compile(r"^(\d+\.\d+) (\S+) (\d+)$", re.MULTILINE)


@attrs.frozen
class Notice:
    """An event that the other machine noticed.

    Attributes:
        when: seconds.
        what: `v3`, the sender's version; or `again`, `failed`, `lost`.
        number: of the message, the call or the goal.
    """

    when: float
    what: str
    number: int


@attrs.frozen
class Kind:
    """A program to update, and one that notices it.

    Attributes:
        judge: returns as text what was lost and what was doubled.
        others: further programs of the release.
        warm: the new node gets publishers before it has its name.
    """

    updated: str
    notices: str
    judge: Callable[[list[Notice], int], str]
    others: Mapping[str, str] = attrs.field(factory=dict)
    warm: bool = False


def judge_messages(found: list[Notice], updates: int) -> str:
    """Return how many numbers did not arrive, and how many arrived twice."""
    counts = Counter(one.number for one in found)
    missing = max(counts) - min(counts) + 1 - len(counts)
    return f"{missing} lost, {sum(counts.values()) - len(counts)} doubled"


def judge_calls(found: list[Notice], updates: int) -> str:
    """Return how many calls failed."""
    counts = Counter(one.what for one in found)
    return f"{counts['again']} calls made twice, {counts['failed']} failed then too"


def judge_maps(found: list[Notice], updates: int) -> str:
    """Return how many versions a subscriber got, and how often."""
    counts = Counter(one.what for one in found)
    got = sum(1 for version in range(1, updates + 1) if counts[f"v{version}"])
    return f"{got} of {updates} maps came, {sum(counts.values()) - len(counts)} doubled"


def judge_goals(found: list[Notice], updates: int) -> str:
    """Return how many goals ended without a result."""
    lost = sum(1 for one in found if one.what == "lost")
    return f"{lost} of {len(found)} goals lost"


KINDS = {
    "subscriber 20 Hz": Kind(
        RELAY, HEARS, judge_messages, {"source": SOURCE.replace("RATE", "20")}
    ),
    "subscriber 100 Hz": Kind(
        RELAY, HEARS, judge_messages, {"source": SOURCE.replace("RATE", "100")}
    ),
    "subscriber 100 Hz, warm": Kind(
        RELAY, HEARS, judge_messages, {"source": SOURCE.replace("RATE", "100")}, warm=True
    ),
    "service 10 Hz": Kind(SERVER, ASKS, judge_calls),
    "latched map": Kind(MAP, SEES, judge_maps),
    "action, goals of 2 s": Kind(ACTION, WANTS, judge_goals),
}


@attrs.frozen
class Stage:
    """A namespace in which a kind is updated and noticed."""

    rollouts: Rollouts
    kind: Kind

    def deploy(self, strategy: str, version: int, late: float) -> bool:
        """Deploy a version of the updated program; return whether it became ready."""
        programs = {"notices": self.kind.notices, **self.kind.others}
        nodes = {
            "updated": {
                "args": ["python3", "-c", self.kind.updated],
                "env": {"VERSION": f"v{version}", "LATE": late},
                "placement": {"apart_from": ["notices"]},
                "update": {"strategy": strategy, "warm": self.kind.warm},
            },
            **{
                name: {"args": ["python3", "-c", code], "update": {"strategy": "Recreate"}}
                for name, code in programs.items()
            },
        }
        more = {"ros_master_image": self.rollouts.image, "gate": strategy == "HandOver"}
        return self.rollouts.deploy("noetic", nodes, more)

    def noticed(self) -> list[Notice]:
        """Return what was noticed so far."""
        found = LINE.findall(self.rollouts.logs("notices"))
        return [Notice(float(when), what, int(number)) for when, what, number in found]

    def until_noticed(self, version: int) -> None:
        """Wait until a version is noticed."""
        until(lambda: any(one.what == f"v{version}" for one in self.noticed()[-20:]))


def measure(stage: Stage, strategy: str, late: float, updates: int) -> tuple[list[Notice], int]:
    """Update so many times; return what was noticed, and how many deploys failed."""
    stage.rollouts.clear()
    stage.deploy(strategy, 0, late)
    stage.until_noticed(0)
    failed = 0
    for version in range(1, updates + 1):
        failed += not stage.deploy(strategy, version, late)
        stage.until_noticed(version)
        time.sleep(1)
    return stage.noticed(), failed


def find_gaps(found: list[Notice]) -> Iterator[float]:
    """Yield the longest time without anything good around the first notice of each version."""
    good = [one for one in found if one.what.startswith("v")]
    firsts = {int(one.what[1:]): one.when for one in reversed(good)}
    for version, first in sorted(firsts.items()):
        if version == 0:
            continue
        names = (f"v{version - 1}", f"v{version}")
        around = [one.when for one in good if one.what in names and one.when < first + 1]
        yield max((b - a for a, b in itertools.pairwise(around)), default=0.0)


def main() -> None:
    """Measure and print."""
    words = arguments()
    place = find_cluster(words.context, "1")
    print("\n| updated | start, s | strategy | median gap, s | longest | noticed | failed |")
    print("|---|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as directory:
        rollouts = Rollouts(*place, SPACE, Path(directory))
        for title, late in itertools.product(KINDS, words.late):
            if not any(title.startswith(kind) for kind in words.kinds):
                continue
            for strategy in words.strategies:
                stage = Stage(rollouts, KINDS[title])
                found, failed = measure(stage, strategy, late, words.updates)
                gaps = list(find_gaps(found)) or [float("nan")]
                once = title.startswith("latched")  # nothing arrives between two maps
                gap = "- | -" if once else f"{median(gaps):.3f} | {max(gaps):.3f}"
                noticed = KINDS[title].judge(found, words.updates)
                print(
                    f"| {title} | {late:g} | {strategy} | {gap} | {noticed}"
                    f" | {failed} of {words.updates} |",
                    flush=True,
                )


def arguments() -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(description=__doc__)

    def words(text: str) -> list[str]:
        return text.split(",")

    parser.add_argument("--updates", type=int, default=20)
    parser.add_argument("--late", type=numbers, default=[0, 5])
    parser.add_argument("--strategies", type=words, default=["HandOver"])
    parser.add_argument(
        "--kinds", type=words, default=["subscriber", "service", "latched", "action"]
    )
    parser.add_argument("--context")
    return parser.parse_args()


if __name__ == "__main__":
    main()

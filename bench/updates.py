"""Updates of a talker under a running listener: the gaps by strategy, as a table.

usage: python -m bench.updates [--ros 1|2] [--updates 20] [--rates 20,100] [--late 0,5]
                               [--strategies ...] [--networks ...] [--context NAME]

The context is one of `rigel cluster`, with two machines (ROS 2: and Multus); left out, one is made
and stays.
"""

from __future__ import annotations

import argparse
import itertools
import re
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import attrs

from bench import updates_ros2
from bench.rollouts import Rollouts, find_cluster, numbers, until

SPACE = "bench-updates"
COLUMNS = (
    *("network", "rate", "start, s", "strategy", "switch, s", "gap, s"),
    *("longest", "missing", "doubled", "failed"),
)
STRATEGIES = ("Recreate", "Rolling", "HandOver")
#: "VERSION NUMBER" in each message; the start is as late as that of a program with a model to load.
TALKER = """
import os, time
time.sleep(float(os.environ["LATE"]))
import rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=100)
rate, number = rospy.Rate(int(os.environ["RATE"])), 0
while not rospy.is_shutdown():
    publisher.publish("%s %d" % (os.environ["VERSION"], number))
    number += 1
    try:
        rate.sleep()
    except rospy.ROSInterruptException:
        break
"""
LISTENER = """
import time, rospy, std_msgs.msg
rospy.init_node("listener")
def hear(message):
    print("heard %.4f %s" % (time.time(), message.data))
rospy.Subscriber("/chatter", std_msgs.msg.String, hear, tcp_nodelay=True)
rospy.spin()
"""
HEARD = re.compile(r"heard ([\d.]+) v(\d+) (\d+)$", re.MULTILINE)


@attrs.frozen
class Update:
    """What a listener received of one update.

    Attributes:
        switch: from the last message of the old talker to the first of the new one, in seconds;
            negative if the old one still came after that.
        gap: the longest time without a message around it, in seconds; the start of the new pod,
            which takes the processors, is part of that.
        missing: messages of the new talker that did not come, though a later one did.
        doubled: messages of the old talker that came after the new one's first.
    """

    switch: float
    gap: float
    missing: int
    doubled: int


@attrs.frozen
class Talk:
    """A talker that is updated, and its listener on another machine.

    Attributes:
        network: of ROS 2, one of updates_ros2.NETWORKS; "" is ROS 1.
    """

    rollouts: Rollouts
    network: str

    def deploy(self, strategy: str, version: int, rate: int, late: float) -> bool:
        """Deploy the talker in a version; return whether it became ready."""
        ros2 = self.network and updates_ros2.describe(self.network)
        distro, talker, listener, more = ros2 or describe_ros1(strategy)
        nodes = {
            "talker": {
                **talker,
                "env": {"VERSION": f"v{version}", "RATE": rate, "LATE": late},
                "placement": {"apart_from": ["listener"]},
                "update": {"strategy": strategy},
            },
            "listener": {**listener, "update": {"strategy": "Recreate"}},
        }
        master = {} if self.network else {"ros_master_image": self.rollouts.image}
        return self.rollouts.deploy(distro, nodes, {**master, **more})

    def heard(self) -> list[tuple[float, int, int]]:
        """Return (time, version, number) of what the listener has heard."""
        found = HEARD.findall(self.rollouts.logs("listener"))
        return [(float(when), int(version), int(number)) for when, version, number in found]

    def until_heard(self, version: int) -> None:
        """Wait until the listener hears a version."""
        until(lambda: any(one[1] == version for one in self.heard()[-20:]))


def describe_ros1(strategy: str) -> tuple[str, dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the distribution, the talker, the listener, and more of the job's options."""
    talker = {"args": ["python3", "-c", TALKER]}
    listener = {"args": ["python3", "-c", LISTENER]}
    return "noetic", talker, listener, {"gate": strategy == "HandOver"}


def measure(
    talk: Talk, strategy: str, rate: int, late: float, updates: int
) -> tuple[list[Update], int]:
    """Update so many times; return what was received of each, and how many deploys failed."""
    talk.rollouts.clear()
    talk.deploy(strategy, 0, rate, late)
    talk.until_heard(0)
    failed = 0
    for version in range(1, updates + 1):
        failed += not talk.deploy(strategy, version, rate, late)
        talk.until_heard(version)
        time.sleep(1)
    return list(judge(talk.heard(), updates)), failed


def judge(found: Sequence[tuple[float, int, int]], updates: int) -> list[Update]:
    """Return the effect of each update on what was received."""
    result = []
    for version in range(1, updates + 1):
        first = next((when for when, v, _ in found if v == version), None)
        if first is None:
            continue
        around = [one for one in found if first - 60 < one[0] < first + 1 and one[1] <= version]
        around = [one for one in around if one[1] >= version - 1]
        gap = max((b[0] - a[0] for a, b in itertools.pairwise(around)), default=0.0)
        old = [when for when, v, _ in found if v == version - 1]
        doubled = sum(1 for when in old if when > first)
        switch = first - max(old, default=first)
        new = {number for _, v, number in found if v == version}
        missing = max(new) - min(new) + 1 - len(new)
        result.append(Update(switch, gap, missing, doubled))
    return result


def main() -> None:
    """Measure and print."""
    words = arguments()
    place = find_cluster(words.context, words.ros)
    networks = words.networks.split(",") if words.ros == "2" else [""]
    print("\n|", " | ".join(COLUMNS), "|\n|" + "---|" * len(COLUMNS))
    with tempfile.TemporaryDirectory() as directory:
        rollouts = Rollouts(*place, SPACE, Path(directory))
        for network, rate, late in itertools.product(networks, words.rates, words.late):
            talk = Talk(rollouts, network)
            for strategy in words.strategies.split(","):
                found, failed = measure(talk, strategy, rate, late, words.updates)
                gaps = [one.gap for one in found] or [float("nan")]
                switch = median([one.switch for one in found] or [float("nan")])
                missing, doubled = sum(u.missing for u in found), sum(u.doubled for u in found)
                print(
                    f"| {network} | {rate} Hz | {late:g} | {strategy}"
                    f" | {switch:.3f} | {median(gaps):.3f} | {max(gaps):.3f}"
                    f" | {missing} | {doubled} | {failed} of {words.updates} |",
                    flush=True,
                )


def arguments() -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(description=__doc__)

    parser.add_argument("--ros", choices=["1", "2"], default="1")
    parser.add_argument("--updates", type=int, default=20)
    parser.add_argument("--rates", type=numbers, default=[20, 100])
    parser.add_argument("--late", type=numbers, default=[0, 5])
    parser.add_argument("--strategies", default=",".join(STRATEGIES))
    parser.add_argument("--networks", default=",".join(updates_ros2.NETWORKS))
    parser.add_argument("--context")
    return parser.parse_args()


if __name__ == "__main__":
    main()

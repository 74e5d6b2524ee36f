"""Updates by Recreate of an image that the machine does not have: the gap, and of what it consists.

usage: python -m bench.pulls [--updates 5] [--mebibytes 300] [--context NAME]

A rospy talker is updated under a listener on another machine, in turn with its image pulled before
its old pod ends, as `rigel` does it, without that, and with an image that the machine has. Each
update has a new image. The context is one of `rigel cluster` with two machines; left out, one is
made and stays.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path
from statistics import median

import attrs

from bench.rollouts import Rollouts, find_cluster
from bench.updates import LISTENER, TALKER, Talk, judge
from tests.support.larger import push_larger

SPACE = "bench-pulls"
RATE = 20
WITHOUT = """
import rigel_k8s.deploy as deploy
deploy.pull_images = lambda *_: None
from rigel_k8s.entry import main
main()
"""
BEFORE, AFTER, THERE = "pulled before", "pulled in the gap", "there already"
PROGRAMS = {
    BEFORE: [sys.executable, "-m", "rigel_k8s"],
    AFTER: [sys.executable, "-c", WITHOUT],
    THERE: [sys.executable, "-m", "rigel_k8s"],
}


def deploy(rollouts: Rollouts, version: int, image: str) -> float:
    """Deploy the talker in a version; return the seconds of that."""
    nodes = {
        "talker": {
            "args": ["python3", "-c", TALKER],
            "image": image,
            "env": {"VERSION": f"v{version}", "RATE": RATE, "LATE": 0},
            "placement": {"node": "node2"},
            "update": {"strategy": "Recreate"},
        },
        "listener": {"args": ["python3", "-c", LISTENER], "placement": {"node": "node1"}},
    }
    more = {"ros_master_image": rollouts.image, "ros_master_placement": {"node": "node1"}}
    started = time.monotonic()
    if not rollouts.deploy("noetic", nodes, more, timeout="300s"):
        raise SystemExit(f"version {version} is not ready")
    return time.monotonic() - started


def measure(rollouts: Rollouts, updates: int, mebibytes: int) -> None:
    """Update in all ways, in turn, and print."""
    talk, ways, image = Talk(rollouts, ""), list(PROGRAMS), rollouts.image
    took: dict[str, list[float]] = defaultdict(list)
    rollouts.clear()
    deploy(rollouts, 0, image)
    talk.until_heard(0)
    for version in range(1, updates * len(ways) + 1):
        way = ways[(version - 1) % len(ways)]
        if way != THERE:  # the last update's image is on the machine
            image = push_larger(rollouts.image, mebibytes)
        took[way].append(deploy(attrs.evolve(rollouts, program=PROGRAMS[way]), version, image))
        talk.until_heard(version)
        time.sleep(1)
    found = judge(talk.heard(), updates * len(ways))
    if len(found) < updates * len(ways):
        raise SystemExit("the listener did not hear all versions")
    gaps = {way: [one.gap for one in found[n :: len(ways)]] for n, way in enumerate(ways)}
    print("\n| image | median gap, s | longest | against there already | deploy, s |")
    print("|---|---|---|---|---|")
    for way, own in gaps.items():
        ratio = median(own) / median(gaps[THERE])
        times = f"{median(own):.2f} | {max(own):.2f} | {ratio:.2f}"
        print(f"| {way} | {times} | {median(took[way]):.1f} |")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--updates", type=int, default=5)
    parser.add_argument("--mebibytes", type=int, default=300)
    parser.add_argument("--context")
    words = parser.parse_args()
    place = find_cluster(words.context, "1")
    with tempfile.TemporaryDirectory() as directory:
        measure(Rollouts(*place, SPACE, Path(directory)), words.updates, words.mebibytes)


if __name__ == "__main__":
    main()

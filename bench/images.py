"""Camera images between two nodes of one machine: received, delay, processor; prints a table.

usage: python -m bench.images PYTHON [--seconds 5] [--turns 3] [--reliability BEST_EFFORT]

PYTHON is the interpreter of an environment with rclpy on Fast DDS, from jazzy on. Needs root: a pod
is a network namespace and a /dev/shm of its own; two pods are joined by a veth pair. The sizes of
buffers are requested by the programs, since net.core.rmem_max belongs to the machine: 208 KiB is
what Linux commonly allows, 4 MB what `rigel` requests. All ways take turns.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.network.dds import transports
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan

NODE = Path(__file__).with_name("image_node.py")
NAMES = [f"images-{os.getpid()}-{side}" for side in "ab"]
MEMORY = 'mount -t tmpfs -o size=512m shm /dev/shm; exec "$@"'


def setting(*, shared: bool) -> str:
    """Return what `rigel` sets for Fast DDS."""
    options = Network(mode="host", shared_memory=shared)
    plan = NetworkPlan("robots", "demo", options, GENERATIONS["2"], "jazzy")
    return str(transports(plan)["FASTDDS_BUILTIN_TRANSPORTS"]["value"])


SMALL, UDP, SHARED = "UDPv4?sockets_size=212992B", setting(shared=False), setting(shared=True)


@attrs.frozen
class Way:
    """Where the two nodes are, and by what they send.

    Attributes:
        place: "pods" (one each), "pod" (both in one), "host" (on the machine's network).
        partners: 0: no one subscribes, which shows what publishing itself costs.
    """

    name: str
    place: str
    transports: str
    partners: int = 1


WAYS = (
    Way("no subscriber", "pod", UDP, 0),
    Way("two pods, UDP, 208 KiB", "pods", SMALL),
    Way("two pods, UDP, 4 MB", "pods", UDP),
    Way("one pod, UDP, 208 KiB", "pod", SMALL),
    Way("one pod, UDP, 4 MB", "pod", UDP),
    Way("one pod, shared memory", "pod", SHARED),
    Way("host, UDP, 4 MB", "host", UDP),
    Way("host, shared memory", "host", SHARED),
)


@contextlib.contextmanager
def pods() -> Iterator[list[list[str]]]:
    """Make the two pods; yield for each the words that run a program in it."""
    one, other = NAMES
    with contextlib.ExitStack() as stack:
        for name in NAMES:
            ip("netns", "add", name)
            stack.callback(ip, "netns", "delete", name)
        ip("-n", one, "link", "add", "eth0", "type", "veth", "peer", "name", "eth0", "netns", other)
        for index, name in enumerate(NAMES, 1):
            ip("-n", name, "address", "add", f"10.91.0.{index}/24", "dev", "eth0")
            for interface in ("lo", "eth0"):
                ip("-n", name, "link", "set", interface, "up")
        holders = []
        for name in NAMES:
            line = ["ip", "netns", "exec", name, "unshare", "--mount", "sh", "-c", MEMORY, "sh"]
            holder = subprocess.Popen([*line, "sh", "-c", "echo; exec cat"], stdin=-1, stdout=-1)
            stack.callback(holder.communicate)
            assert holder.stdout
            holder.stdout.readline()
            holders.append(str(holder.pid))
        yield [["nsenter", "--net", "--mount", "--target", pid] for pid in holders]


def ip(*words: str) -> None:
    """Run ip."""
    subprocess.run(["ip", *words], check=True)


def measure(way: Way, enter: Sequence[list[str]], python: str, *words: str) -> dict[str, Any]:
    """Return what one turn of a way found."""
    sender, taker = {"pods": enter, "pod": [enter[0]] * 2, "host": [[], []]}[way.place]
    env = {"FASTDDS_BUILTIN_TRANSPORTS": way.transports, "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
    env = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", **env}
    lines = [[*taker, python, str(NODE), "subscribe", *words]] * way.partners
    lines.append([*sender, python, str(NODE), "publish", *words])
    programs = [
        subprocess.Popen([*line, str(way.partners)], env=env, stdout=subprocess.PIPE)
        for line in lines
    ]
    found: dict[str, Any] = {"delays": [], "cpu": 0.0}
    for program in programs:
        answer = json.loads(program.communicate(timeout=120)[0].splitlines()[-1])
        found = {**found, **answer, "cpu": found["cpu"] + answer["cpu"]}
    return found


def row(size: int, name: str, turns: list[dict[str, Any]]) -> str:
    """Return one row of the table, of all turns together."""
    sent = sum(turn["sent"] for turn in turns)
    delays = sorted(delay * 1000 for turn in turns for delay in turn["delays"])
    median = f"{statistics.median(delays):.1f}" if delays else ""
    late = f"{delays[int(len(delays) * 0.95)]:.0f}" if delays else ""
    work = sum(turn["cpu"] for turn in turns) / sent * 1000
    arrived = f"{len(delays)} of {sent}"
    return f"| {size / 1e6:.0f} MB | {name} | {arrived} | {median} | {late} | {work:.1f} |"


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("python")
    parser.add_argument("--seconds", type=float, default=5)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--reliability", default="BEST_EFFORT", choices=["BEST_EFFORT", "RELIABLE"])
    asked = parser.parse_args()
    found: dict[tuple[int, str], list[dict[str, Any]]] = defaultdict(list)
    with pods() as enter:
        for _ in range(asked.turns):
            for size in (10**6, 6 * 10**6):
                for way in WAYS:
                    words = str(size), str(asked.seconds), asked.reliability
                    found[size, way.name].append(measure(way, enter, asked.python, *words))
    head = "| size | nodes | received | delay, ms | 95 % | processor, ms an image |"
    rows = [row(size, name, turns) for (size, name), turns in found.items()]
    sys.stdout.write("\n".join([head, "|---|---|---|---|---|---|", *rows, ""]))


if __name__ == "__main__":
    main()

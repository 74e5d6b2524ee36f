"""What it costs to watch 200 topics with 5,000 messages a second; prints a table.

usage: python -m bench.watching [--seconds 20] [--turns 3]

Four nodes in C publish 50 topics each at 25 Hz, four others hear them, on Fast DDS by UDP, each in
a network of its own. They are watched by the library in their processes, their keepers and the
exporter, which compares all topics with what is expected of them; or by a program of rclpy that
subscribes to all topics without unpacking messages, as `ros2 topic hz` does. All ways take turns.
Needs root, ziglang, and PyPI.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from rigel_k8s.network.modes.peers import peer_name
from tests.ros2.conftest import Lab, Pod, environment
from tests.ros2.test_exporter import SOURCES
from tests.support.ros2_c import compile_ros
from tests.support.until import until

KINDS = ("nodes", "keepers", "watcher")
PAIRS, TOPICS, RATE = 4, 50, 25
TICKS = os.sysconf("SC_CLK_TCK")
ENV = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_DOMAIN_ID": "0"}
#: As `ros2 topic hz` for several topics: it counts what arrives.
SUBSCRIBER = """
import sys, rclpy
from std_msgs.msg import Int64
rclpy.init()
node, heard = rclpy.create_node("watcher"), [0]
def hear(_):
    heard[0] += 1
for topic in sys.argv[1:]:
    node.create_subscription(Int64, topic, hear, 10, raw=True)
node.create_timer(1.0, lambda: print("heard", heard[0], flush=True))
print("up", flush=True)
rclpy.spin(node)
"""


def list_topics() -> list[str]:
    """Return the names of all topics."""
    return [f"/pair{pair}_{number}" for pair in range(PAIRS) for number in range(TOPICS)]


def start_nodes(lab: Lab, program: Path, *, layer: bool) -> list[Pod]:
    """Start the nodes."""
    pods = []
    for pair in range(PAIRS):
        for name, does in ((f"talker{pair}", "publish"), (f"listener{pair}", "hear")):
            words = [str(program), name, does, f"pair{pair}", str(TOPICS), str(RATE)]
            env = dict(ENV)
            if layer:
                words = ["/bin/sh", str(lab.scripts() / "rmw.sh"), *words]
                env |= {"RIGEL_RMW": str(lab.folder / f"notes-{name}"), "RIGEL_K8S_WORKLOAD": name}
            pods.append(lab.start(name, "one", *words, **env))
    for pod in pods:
        until(lambda pod=pod: "up" in pod.log(), f"start of {pod.name}", 120)
    return pods


def start_exporter(lab: Lab, pods: list[Pod]) -> Pod:
    """Start the exporter's program, as a release does."""
    config = {
        "ros": "2",
        "keepers": [f"{peer_name(pod.name)}:11399" for pod in pods],
        "expected": {f"/{pod.name}": pod.name for pod in pods},
        "contract": {topic: {"rate": [RATE * 0.8, RATE * 1.2]} for topic in list_topics()},
    }
    path = lab.folder / "config.json"
    path.write_text(json.dumps(config))
    words = [sys.executable, "-m", "rigel_exporter", str(path)]
    return lab.start("exporter", "one", *words, PYTHONPATH=SOURCES)


def start_subscriber(lab: Lab) -> Pod:
    """Start the program that subscribes to all topics."""
    return lab.python("watcher", "one", "jazzy", SUBSCRIBER, *list_topics(), **ENV)


def list_processes(pod: Pod) -> Iterator[int]:
    """Yield the pod's processes as the machine numbers them."""
    own = str(Path(f"/proc/{pod.init}/ns/pid").readlink())
    for folder in Path("/proc").iterdir():
        try:
            if folder.name.isdecimal() and str((folder / "ns" / "pid").readlink()) == own:
                yield int(folder.name)
        except OSError:
            continue  # it has ended


def read_cpu(process: int) -> float:
    """Return seconds that a process and its children that have ended have worked."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:15])) / TICKS


def read_all(pods: list[Pod], watcher: Pod | None) -> dict[str, float]:
    """Return the seconds of the nodes, of the keepers beside them, and of what watches them."""
    found = dict.fromkeys(KINDS, 0.0)
    for pod in [*pods, *([watcher] if watcher else [])]:
        for process in list_processes(pod):
            beside = "nodes" if process == pod.init else "keepers"
            found["watcher" if pod is watcher else beside] += read_cpu(process)
    return found


def measure(way: str, seconds: float) -> dict[str, float]:
    """Return the processor time of one turn of a way, in ms for each second."""
    with tempfile.TemporaryDirectory() as room, ExitStack() as stack:
        lab = Lab(Path(room), stack, environment)
        program = compile_ros(environment("jazzy"), Path(room), "jazzy", "topics")
        pods = start_nodes(lab, program, layer=way in ("the library", "the exporter"))
        watcher = None
        if way == "the exporter":
            watcher = start_exporter(lab, pods)
        if way == "a subscriber":
            watcher = start_subscriber(lab)
        time.sleep(10)  # they discover each other
        before, began = read_all(pods, watcher), time.monotonic()
        time.sleep(seconds)
        after, span = read_all(pods, watcher), time.monotonic() - began
        if watcher and way == "a subscriber":
            heard = int(watcher.log().split()[-1])
            assert heard > PAIRS * TOPICS * RATE * seconds / 2, watcher.log()
    return {kind: (after[kind] - before[kind]) / span * 1000 for kind in before}


WAYS = {
    "nothing": "nothing",
    "the library": "the library in the nodes, and their keepers",
    "the exporter": "the same, and the exporter",
    "a subscriber": "a subscriber of rclpy to all topics",
}


def main() -> None:
    """Measure, and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20)
    parser.add_argument("--turns", type=int, default=3)
    asked = parser.parse_args()
    found: dict[str, list[dict[str, float]]] = defaultdict(list)
    for _ in range(asked.turns):
        for way in WAYS:
            found[way].append(measure(way, asked.seconds))
    heads = " | ".join(f"{kind}, ms/s" for kind in KINDS)
    sys.stdout.write(f"| watched by | {heads} | watcher / nodes |\n|---|---|---|---|---|\n")
    for way, words in WAYS.items():
        nodes, *others = (statistics.median(turn[kind] for turn in found[way]) for kind in KINDS)
        cells = " | ".join(f"{one:.1f}" for one in (nodes, *others))
        sys.stdout.write(f"| {words} | {cells} | {others[-1] / nodes:.1%} |\n")


if __name__ == "__main__":
    main()

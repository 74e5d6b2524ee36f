"""What turns unready or restarts while this machine is overloaded.

usage: python -m bench.load --context NAME [--busy 60] [--seconds 180] [--ros 1,2]

The context is one of `rigel cluster`, which runs on this machine. A small application of each ROS
is deployed; then endless computing processes run beside it, each in a session of its own: Linux
gives each session the same share, so those of one session would count as a single process.
Every change of readiness is counted, from the API server's watches.
"""

from __future__ import annotations

import argparse
import itertools
import os
import re
import subprocess
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import attrs

from bench.rollouts import Rollouts, find_cluster
from rigel_k8s.kube import connect
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.settings import Settings

ENDLESS = ["sh", "-c", "while :; do :; done"]
#: Seconds before and after the load: what the deploy itself changes is over, what was late is seen.
CALM = 20.0
MASTER = "ros-master"
ROS1_TALKER = """
import rospy, std_msgs.msg
rospy.init_node("talker")
publisher = rospy.Publisher("chatter", std_msgs.msg.String, queue_size=10)
rate = rospy.Rate(10)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rate.sleep()
"""
ROS1_LISTENER = """
import time, rospy, std_msgs.msg
rospy.init_node("listener")
rospy.Subscriber("chatter", std_msgs.msg.String, lambda _: print("heard %.3f" % time.time()))
rospy.spin()
"""
#: Calls the master over a connection of its own each second.
CALLER = """
import os, rospy, socket, time, xmlrpc.client
rospy.init_node("caller")
socket.setdefaulttimeout(60)
while not rospy.is_shutdown():
    started = time.time()
    try:
        xmlrpc.client.ServerProxy(os.environ["ROS_MASTER_URI"]).getUri("/caller")
        print("called %.3f %.3f" % (started, time.time() - started))
    except OSError as error:
        print("failed %.3f %r" % (started, error))
    time.sleep(1)
"""
ROS2_TALKER = """
import rclpy, std_msgs.msg
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(std_msgs.msg.String, "chatter", 10)
node.create_timer(0.1, lambda: publisher.publish(std_msgs.msg.String(data="hello")))
rclpy.spin(node)
"""
ROS2_LISTENER = """
import time, rclpy, std_msgs.msg
rclpy.init()
node = rclpy.create_node("listener")
say = lambda _: print("heard %.3f" % time.time(), flush=True)
node.create_subscription(std_msgs.msg.String, "chatter", say, 10)
rclpy.spin(node)
"""


@attrs.define
class Watched:
    """One pod, or the endpoints of a Service.

    Attributes:
        changes: how often it turned ready or unready.
        unready: for how many seconds it was not ready.
        since: when it was last seen to change, by the monotonic clock.
        restarts: of its containers, in this time.
    """

    ready: bool
    since: float
    first_restarts: int = 0
    changes: int = 0
    unready: float = 0.0
    restarts: int = 0

    def see(self, *, ready: bool, restarts: int, now: float) -> None:
        """Record its current state."""
        self.restarts = restarts - self.first_restarts
        if ready != self.ready:
            self.settle(now)
            self.changes += 1
            self.ready = ready

    def settle(self, now: float) -> None:
        """Count the time until now."""
        self.unready += 0.0 if self.ready else now - self.since
        self.since = now


@attrs.frozen
class Ledger:
    """What is watched in one namespace; names of pods are unique, so new ones are visible."""

    seen: dict[str, Watched] = attrs.field(factory=dict)

    def note(self, name: str, *, ready: bool, restarts: int, now: float) -> None:
        """Take in one event."""
        found = self.seen.setdefault(name, Watched(ready, now, restarts))
        found.see(ready=ready, restarts=restarts, now=now)

    def note_pod(self, pod: Mapping[str, Any], now: float) -> None:
        """Take in an event about a pod."""
        states = (pod.get("status") or {}).get("containerStatuses") or []
        restarts = sum(int(one["restartCount"]) for one in states)
        self.note(pod["metadata"]["name"], ready=is_ready(pod), restarts=restarts, now=now)

    def note_slice(self, found: Mapping[str, Any], now: float) -> None:
        """Take in an event about a Service's endpoints."""
        name = found["metadata"]["labels"]["kubernetes.io/service-name"]
        ready = any(one["conditions"].get("ready") for one in found.get("endpoints") or [])
        self.note(f"Service {name}", ready=ready, restarts=0, now=now)


def watch(cluster: Any, namespace: str, ledger: Ledger, end: threading.Event) -> None:
    """Follow a namespace's pods, and the master's endpoints, until the end."""
    kinds = (
        ("v1", "Pod", None, ledger.note_pod),
        (
            "discovery.k8s.io/v1",
            "EndpointSlice",
            f"kubernetes.io/service-name={MASTER}",
            ledger.note_slice,
        ),
    )

    def follow(api_version: str, kind: str, labels: str | None, note: Any) -> None:
        while not end.is_set():
            for event in cluster.watch(api_version, kind, namespace, labels=labels, cancel=end):
                note(event.object, time.monotonic())

    for kind in kinds:
        threading.Thread(target=follow, args=kind, daemon=True).start()


def describe(ros: str, image: str) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Return the distribution, the nodes, and more of the job's options."""
    if ros == "2":
        texts = {"talker": ROS2_TALKER, "listener": ROS2_LISTENER}
        distro, more = "jazzy", {"network": {"mode": "peers"}}
    else:
        texts = {"talker": ROS1_TALKER, "listener": ROS1_LISTENER, "caller": CALLER}
        distro, more = "noetic", {"ros_master_image": image}
    nodes = {name: {"args": ["python3", "-u", "-c", text]} for name, text in texts.items()}
    return distro, nodes, more


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep so many processes computing, each in a session of its own."""
    running = [subprocess.Popen(ENDLESS, start_new_session=True) for _ in range(count)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
        for process in running:
            process.wait()


def measure_load(seconds: float) -> list[float]:
    """Wait; return the load in that time, every five seconds."""
    end, found = time.monotonic() + seconds, []
    while time.monotonic() < end:
        time.sleep(5)
        found.append(os.getloadavg()[0])
    return found


def judge_calls(log: str, since: float) -> str:
    """Return the results of the calls to the master as text, with the most common failure."""
    calls = [m.groups() for m in re.finditer(r"^called ([\d.]+) ([\d.]+)$", log, re.MULTILINE)]
    took = [float(took) for when, took in calls if float(when) >= since]
    found = re.findall(r"^failed ([\d.]+) (.*)$", log, re.MULTILINE)
    failed = Counter(error for when, error in found if float(when) >= since)
    why = "".join(f" (most often {error})" for error, _ in failed.most_common(1))
    return (
        f"{len(took) + failed.total()} calls to the master, {failed.total()} failed{why},"
        f" {max(took, default=float('nan')):.1f} s the longest"
    )


def longest_gap(log: str, since: float, end: float) -> float:
    """Return the longest time in which a listener received nothing."""
    times = [float(one) for one in re.findall(r"^heard ([\d.]+)$", log, re.MULTILINE)]
    late = [since, *(one for one in times if since <= one < end), end]
    return max(b - a for a, b in itertools.pairwise(late))


def rows(ros: str, ledger: Ledger) -> Iterator[str]:
    """Yield the table's rows for one application."""
    for name, one in sorted(ledger.seen.items()):
        one.settle(time.monotonic())
        yield f"| {ros} | {name} | {one.changes} | {one.unready:.0f} | {one.restarts} |"


def main() -> None:
    """Measure and print."""
    words = arguments()
    with (
        tempfile.TemporaryDirectory() as directory,
        connect(Settings(context=words.context)) as cluster,
    ):
        places = {ros: deploy(words.context, ros, Path(directory)) for ros in words.ros.split(",")}
        time.sleep(CALM)
        end, ledgers, since = threading.Event(), {ros: Ledger() for ros in places}, time.time()
        for ros, place in places.items():
            watch(cluster, place.namespace, ledgers[ros], end)
        before = os.getloadavg()[0]
        with busy(words.busy):
            load = measure_load(words.seconds)
        time.sleep(CALM)
        end.set()
        report(words, places, ledgers, since, [before, *load])
        for place in places.values():
            place.kubectl("delete", "namespace", place.namespace, "--wait=false")


def deploy(context: str, ros: str, directory: Path) -> Rollouts:
    """Deploy the application of one ROS."""
    found = Rollouts(*find_cluster(context, ros), f"bench-load-{ros}", directory)
    found.clear()
    distro, nodes, more = describe(ros, found.image)
    if not found.deploy(distro, nodes, more, timeout="15m"):
        raise SystemExit(f"the application of ROS {ros} did not become ready")
    return found


def report(
    words: argparse.Namespace,
    places: Mapping[str, Rollouts],
    ledgers: Mapping[str, Ledger],
    since: float,
    load: Sequence[float],
) -> None:
    """Print the results."""
    print(
        f"\n{words.busy} busy processes for {words.seconds:g} s on {os.cpu_count()} cores; load"
        f" {load[0]:.0f} before, {max(load):.0f} at most\n"
    )
    print("| ROS | what | changes of readiness | seconds not ready | restarts |")
    print("|---|---|---|---|---|")
    for ros, ledger in ledgers.items():
        print("\n".join(rows(ros, ledger)))
    print()
    now = time.time()
    for ros, place in places.items():
        gap = longest_gap(place.logs("listener"), since, now)
        print(f"ROS {ros}: {gap:.1f} s the longest time without a message")
    if "1" in places:
        print(judge_calls(places["1"].logs("caller"), since))


def arguments() -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(prog="python -m bench.load", description=__doc__)
    parser.add_argument("--context", required=True)
    parser.add_argument("--busy", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=180)
    parser.add_argument("--ros", default="1,2")
    return parser.parse_args()


if __name__ == "__main__":
    main()

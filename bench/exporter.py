"""The costs of the ROS exporter: CPU and memory by topics, and by its subscriptions.

usage: python -m bench.exporter --context rigel-NAME [--seconds 60]

It needs a cluster of `rigel cluster up --with observability`. Publishers and one subscriber are
real rospy nodes; the CPU is that of the exporter's own counters.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.kube import connect
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Settings
from rigel_lab import cluster as lab

NODES = 5
PUBLISH = """
import rospy, std_msgs.msg as m, sys
rospy.init_node("publisher")
first, count, rate, size = {first}, {count}, {rate}, {size}
ps = [rospy.Publisher("/topic_%d" % i, m.String, queue_size=1) for i in range(first, first + count)]
message, r = m.String("x" * size), rospy.Rate(rate)
while not rospy.is_shutdown():
    for p in ps: p.publish(message)
    r.sleep()
"""
HEAR = """
import rospy
rospy.init_node("hearer")
subs = [rospy.Subscriber("/topic_%d" % i, rospy.AnyMsg, lambda s: None) for i in range({count})]
rospy.spin()
"""


@attrs.frozen
class Case:
    """One line of the table: rates in messages a second, sizes in bytes."""

    topics: int
    rate: float
    size: int
    named: int

    @property
    def nodes(self) -> dict[str, Any]:
        """The application's nodes: publishers with their share of the topics, and a subscriber."""
        makers = min(NODES, self.topics)
        share = self.topics // makers
        found = {
            f"publisher_{n}": program(
                PUBLISH.format(first=n * share, count=share, rate=self.rate, size=self.size)
            )
            for n in range(makers)
        }
        return found | {"hearer": program(HEAR.format(count=self.topics))}


CASES = (
    Case(10, 1, 100, 0),
    Case(100, 1, 100, 0),
    Case(200, 1, 100, 0),
    Case(10, 10, 100, 10),
    Case(1, 100, 100, 1),
    Case(1, 1000, 100, 1),
    Case(1, 30, 1_000_000, 1),
)


def program(code: str) -> dict[str, Any]:
    return {"args": ["python3", "-c", code]}


def main() -> None:
    """Measure and print."""
    words = arguments()
    registry = lab.status(words.context.removeprefix("rigel-")).registry
    run("image", "ros1-base", "--push", f"{registry}/ros:noetic")
    exporter = f"{registry}/bench/ros-exporter:{uuid.uuid4().hex[:8]}"
    run("image", "ros-exporter", "--push", exporter)
    print(
        "| topics | messages/s each | bytes | named | heard/s | CPU of one core | look ms | MiB |"
    )
    print("|---|---|---|---|---|---|---|---|", flush=True)
    with connect(Settings(context=words.context)) as cluster:
        for case in CASES:
            print(measure(cluster, words, registry, exporter, case), flush=True)


def measure(
    cluster: Cluster, words: argparse.Namespace, registry: str, exporter: str, case: Case
) -> str:
    """Deploy a case, let it run, and return its line of the table."""
    namespace = f"bench-exporter-{uuid.uuid4().hex[:6]}"
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": namespace}})
    try:
        deploy(words.context, namespace, registry, exporter, case)
        time.sleep(15)  # until all connections are made
        first, began = metrics(cluster, namespace), time.monotonic()
        time.sleep(words.seconds)
        last, took = metrics(cluster, namespace), time.monotonic() - began
    finally:
        cluster.delete(ObjectRef("v1", "Namespace", "", namespace))
    cpu = (last["process_cpu_seconds_total{}"] - first["process_cpu_seconds_total{}"]) / took
    heard = (
        total(last, "ros_topic_messages_total") - total(first, "ros_topic_messages_total")
    ) / took
    there = sum(name.startswith("ros_topic_publishers{") for name in last)
    assert there >= case.topics, f"{there} topics are there"
    look = last["ros_exporter_collect_seconds{}"] * 1000
    memory = last["process_resident_memory_bytes{}"] / 2**20
    line = f"| {case.topics} | {case.rate} | {case.size} | {case.named} "
    line += f"| {heard:.0f} "
    return line + f"| {cpu * 100:.2f} % | {look:.0f} | {memory:.0f} |"


def total(scrape: Mapping[str, float], name: str) -> float:
    """The sum of a metric's series."""
    return sum(value for key, value in scrape.items() if key.startswith(f"{name}{{"))


def deploy(context: str, namespace: str, registry: str, exporter: str, case: Case) -> None:
    """Deploy a case's nodes and the exporter."""
    image = f"{registry}/ros:noetic"
    named = [f"/topic_{n}" for n in range(case.named)]
    job = {
        "namespace": namespace,
        "ros_master_image": image,
        "image": image,
        "nodes": case.nodes,
        "observability": {
            "enabled": True,
            "grafana": {"enabled": False},
            "ros_metrics": {"image": exporter, "topics": named},
        },
    }
    jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "Rigelfile"
        file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
        run("--context", context, "-f", str(file), "run", "job", "deploy")


def metrics(cluster: Cluster, namespace: str) -> Mapping[str, float]:
    """One scrape through the API server."""
    labels = {"app.kubernetes.io/name": "ros-exporter"}
    [pod] = cluster.list("v1", "Pod", namespace, labels=labels)
    ref = ObjectRef("v1", "Pod", namespace, str(pod["metadata"]["name"]))
    text = cluster.get_through_proxy(ref, "metrics", port=9419).decode()
    lines = (line.rpartition(" ") for line in text.splitlines() if not line.startswith("#"))
    return {name: float(value) for name, _, value in lines}


def run(*words: str) -> None:
    """Run rigel; end with its output if it fails."""
    command: Sequence[str] = [sys.executable, "-m", "rigel_k8s", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(done.stdout + done.stderr)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="what the ROS exporter costs")
    parser.add_argument("--context", required=True, help="a local cluster's context")
    parser.add_argument("--seconds", type=float, default=60, help="how long each case runs")
    return parser.parse_args()


if __name__ == "__main__":
    main()

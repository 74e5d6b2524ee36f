"""The costs of the observability stack: idle, with ROS nodes that log, and with many topics.

usage: python -m bench.observability --context rigel-NAME [--image ROS1_IMAGE] [--seconds 120]

The stack must be installed (`observability: {enabled: true}`). Its CPU and memory come from its own
Prometheus, its disk is counted on its claims. Lines contain their time, and queries to Loki show
how soon they are found.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import attrs
import yaml

from rigel_k8s.kube import connect
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.installation import find_namespace
from rigel_k8s.settings import Settings

PARTS = ("loki", "promtail", "prometheus", "kube-state-metrics", "node-exporter", "ros-exporter")
CLAIMS = ("loki-data", "prometheus-data")
LOG = """
import rospy, sys, time
rospy.init_node("{name}")
period, due, count = 1.0 / {rate}, time.time(), 0
while not rospy.is_shutdown():
    sys.stdout.write("[INFO] [%f]: bench %d a line as long as those that ROS nodes write\\n"
                     % (time.time(), count))
    sys.stdout.flush()
    count, due = count + 1, due + period
    time.sleep(max(0, due - time.time()))
"""
PUBLISH = """
import rospy, std_msgs.msg as m
rospy.init_node("{name}")
ps = [rospy.Publisher("/{name}_%d" % i, m.String, queue_size=1) for i in range({rate})]
r = rospy.Rate(1)
while not rospy.is_shutdown():
    for p in ps: p.publish("x")
    r.sleep()
"""


@attrs.frozen
class Bench:
    """One cluster with its stack."""

    cluster: Cluster
    context: str
    namespace: str
    image: str
    seconds: int

    def ask(self, service: str, port: int, path: str, **query: object) -> list[Any]:
        """Return the answer of a Service of the stack."""
        ref = ObjectRef("v1", "Service", self.namespace, service)
        answer = json.loads(self.cluster.get_through_proxy(ref, path, port=port, query=query))
        found: list[Any] = answer["data"]["result"]
        return found

    def metric(self, query: str) -> dict[str, float]:
        """Return a value for each workload, or for "" if the query gives one for all."""
        found = self.ask("prometheus", 9090, "api/v1/query", query=query)
        return {s["metric"].get("workload", ""): float(s["value"][1]) for s in found}

    def costs(self, case: str) -> Iterator[str]:
        """Yield the rows of a case, measured over its whole time."""
        time.sleep(self.seconds + 30)  # a scrape every 15 s
        joined = "* on (namespace, pod) group_left (workload) pod:rigel_identity:info"
        containers = 'container!="", container!="POD"'
        cpu = self.metric(
            "sum by (workload) (sum by (namespace, pod)"
            f" (rate(container_cpu_usage_seconds_total{{{containers}}}[{self.seconds}s])) {joined})"
        )
        memory = self.metric(
            "sum by (workload) (sum by (namespace, pod)"
            f" (container_memory_working_set_bytes{{{containers}}}) {joined})"
        )
        for part in PARTS:
            if part in cpu:
                yield f"| {case} | {part} | {cpu[part] * 1000:.0f} | {memory[part] / 2**20:.0f} |"

    def facts(self) -> str:
        """Return series, samples and lines as one line."""
        one = {name: self.metric(query).get("", 0.0) for name, query in FACTS.items()}
        return ", ".join(f"{name} {value:.1f}" for name, value in one.items())

    def disk(self, claim: str) -> int:
        """Return how many KiB of a claim are used, counted by a pod that mounts it."""
        ref = ObjectRef("v1", "Pod", self.namespace, f"du-{claim}-{uuid.uuid4().hex[:6]}")
        counter = {
            "name": "du",
            "image": self.image,
            "command": ["du", "-sk", "/data"],
            "volumeMounts": [{"name": "data", "mountPath": "/data", "readOnly": True}],
        }
        volume = {"name": "data", "persistentVolumeClaim": {"claimName": claim}}
        spec = {"restartPolicy": "Never", "containers": [counter], "volumes": [volume]}
        meta = {"name": ref.name, "namespace": ref.namespace}
        self.cluster.create({"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": spec})
        try:
            while (self.cluster.get(ref) or {})["status"].get("phase") != "Succeeded":
                time.sleep(0.5)
            return int(next(iter(self.cluster.logs(ref.namespace, ref.name))).split()[0])
        finally:
            self.cluster.delete(ref)

    def found_after(self, selector: str, times: int = 20) -> list[float]:
        """Return seconds from when lines were written until a query found them."""
        waits = []
        for _ in range(times):
            start = time.time()
            while not (line := self._newest(selector, start)):
                time.sleep(0.05)
            waits.append(time.time() - line)
            time.sleep(1)
        return waits

    def _newest(self, selector: str, after: float) -> float | None:
        """Return the time in the oldest line that was written after a moment."""
        words = {"query": selector, "start": int(after * 1e9), "limit": 1, "direction": "forward"}
        streams = self.ask("loki", 3100, "loki/api/v1/query_range", **words)
        lines = [line for one in streams for _, line in one["values"]]
        return min((float(line.split("[")[2].split("]")[0]) for line in lines), default=None)


FACTS = {
    "series": 'sum by () (count({__name__=~".+"}))',
    "samples/s": "sum by () (rate(prometheus_tsdb_head_samples_appended_total[2m]))",
    "lines/s": "sum by () (rate(loki_distributor_lines_received_total[1m]))",
    "KiB/s of lines": "sum by () (rate(loki_distributor_bytes_received_total[1m])) / 1024",
}


@contextmanager
def application(
    bench: Bench, program: str, count: int, rate: float, topics: int = 0
) -> Iterator[str]:
    """Deploy ROS nodes that run a program; yields their namespace."""
    namespace = f"bench-{uuid.uuid4().hex[:6]}"
    nodes = {
        f"node_{i}": {"args": ["python3", "-u", "-c", program.format(name=f"node_{i}", rate=rate)]}
        for i in range(count)
    }
    names = [f"/node_{i % count}_{i // count}" for i in range(topics)]
    job = {
        "namespace": namespace,
        "ros_master_image": bench.image,
        "image": bench.image,
        "nodes": nodes,
        "observability": {
            "enabled": True,
            "collector": "promtail",
            "ros_metrics": {"topics": names},
        },
    }
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "Rigelfile"
        jobs = {"deploy": {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}}
        file.write_text(yaml.safe_dump({"application": {"distro": "noetic"}, "jobs": jobs}))
        command = [sys.executable, "-m", "rigel_k8s", "--context", bench.context, "-f", str(file)]
        subprocess.run([*command, "run", "job", "deploy", "--timeout", "10m"], check=True)
        try:
            yield namespace
        finally:
            bench.cluster.delete(ObjectRef("v1", "Namespace", "", namespace))


def main() -> None:
    """Measure and print."""
    words = arguments()
    with connect(Settings(context=words.context)) as cluster:
        namespace = find_namespace(cluster)
        if namespace is None:
            raise SystemExit(
                "no stack is installed: deploy one with observability: {enabled: true}"
            )
        bench = Bench(cluster, words.context, namespace, words.image, words.seconds)
        print("| case | part | CPU, thousandths of a core | MiB |\n|---|---|---|---|")
        show(bench, "idle")
        with application(bench, LOG, words.nodes, words.lines) as space:
            show(bench, f"{words.nodes} nodes, {words.lines} lines/s each")
            waits = bench.found_after(f'{{namespace="{space}", ros_node="/node_0"}} |= "bench"')
        print(
            f"a line is found after {statistics.median(waits):.2f} s (median of {len(waits)},"
            f" {min(waits):.2f} to {max(waits):.2f})"
        )
        each = words.topics // words.nodes
        with application(bench, PUBLISH, words.nodes, each, words.topics):
            show(bench, f"{words.topics} topics at 1 Hz, all named")


def show(bench: Bench, case: str) -> None:
    """Print the rows of a case, and the size and growth of its disks."""
    start, before = time.time(), {claim: bench.disk(claim) for claim in CLAIMS}
    for row in bench.costs(case):
        print(row, flush=True)
    hours = (time.time() - start) / 3600
    for claim, held in before.items():
        now = bench.disk(claim)
        growth = (now - held) / 1024 / hours
        print(f"{case}: {claim} {now / 1024:.1f} MiB on disk, {growth:+.1f} MiB an hour")
    print(f"{case}: {bench.facts()}", flush=True)


def arguments() -> argparse.Namespace:
    """Return the command line's options."""
    parser = argparse.ArgumentParser(prog="python -m bench.observability", description=__doc__)
    parser.add_argument("--context", required=True)
    parser.add_argument("--image", required=True, help="a ROS 1 image that the cluster can pull")
    parser.add_argument("--nodes", type=int, default=20)
    parser.add_argument("--lines", type=int, default=100, help="lines a second of each node")
    parser.add_argument("--topics", type=int, default=200)
    parser.add_argument("--seconds", type=int, default=120, help="for how long to measure")
    return parser.parse_args()


if __name__ == "__main__":
    main()

"""ROS 2 by network mode: discovery, latency and loss, the first message; prints tables of ratios.

usage: python -m bench.ros2 [--only discovery,flow,first] [--members 2,20,50] [--rounds 3]
                            [--context NAME]

The context is one of `rigel cluster`, with three machines and Multus; left out, such a cluster is
created and stays. The compared modes take turns within one run.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

import attrs
import yaml

from rigel_lab import cluster as lab

NODES = Path(__file__).parent / "ros2_nodes"
EXAMPLE = Path(__file__).parents[1] / "examples" / "ros2-talker-listener"
OWN = "rigel-bench2"
#: The extras of its own cluster.
EXTRAS = ("--with", "multus", "--with", "kubectl")
SPACE = "bench-ros2"
LAN = {"mode": "macvlan", "interface": "eth0", "subnet": "10.199.0.0/16", "ipam": "static"}
#: Rigelfile's `network` by the name in the tables.
MODES: dict[str, dict[str, Any]] = {
    "macvlan": {**LAN, "domain_id": 42},
    "peers": {"mode": "peers"},
    "discovery-server": {"mode": "discovery-server"},
    "host": {"mode": "host", "domain_id": 42},
}
MANY = 50  # participants; each start costs the machine seconds
FIRST = re.compile(r"\[(\d+\.\d+)\] \[listener\]: I heard")


@attrs.frozen
class Bench:
    """A cluster, and where Rigelfiles are written."""

    context: str
    kubectl_program: str
    registry: str
    directory: Path

    def kubectl(self, *words: str, text: str | None = None) -> str:
        """Run kubectl in the bench's namespace."""
        head = [self.kubectl_program, "--context", self.context, "-n", SPACE]
        done = subprocess.run([*head, *words], input=text, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"kubectl {' '.join(words)}: {done.stderr}")
        return done.stdout

    def rigel(self, *words: str) -> str:
        """Run rigel on the Rigelfile written last."""
        head = [sys.executable, "-m", "rigel_k8s", "-f", str(self.directory / "Rigelfile")]
        command = [*head, "--context", self.context, "-n", SPACE, *words]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"rigel {' '.join(words)}: {done.stdout}{done.stderr}")
        return done.stdout

    def deploy(self) -> None:
        """Deploy; discovery need not be complete when the check of the graph ends."""
        try:
            self.rigel("run", "job", "deploy")
        except SystemExit as error:
            if "is deployed, but" not in str(error):
                raise

    def fresh(self) -> None:
        """Empty the namespace."""
        self.kubectl("delete", "ns", SPACE, "--ignore-not-found", "--wait")
        self.kubectl("create", "ns", SPACE)

    def write(self, network: dict[str, Any], nodes: dict[str, Any], image: str) -> None:
        """Write a Rigelfile with one job."""
        options = {"image": image, "network": network, "nodes": nodes}
        job = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": options}
        whole = {"application": {"distro": "jazzy"}, "jobs": {"deploy": job}}
        (self.directory / "Rigelfile").write_text(yaml.safe_dump(whole, sort_keys=False))

    def image(self, name: str, context: Path) -> str:
        """Build an image on ROS 2's base image and push it."""
        options = {
            "image": f"{self.registry}/{name}",
            "push": True,
            "platforms": [],
            "context": str(context),
            "dockerfile": str(context / "Dockerfile"),
            "buildargs": {"BASE_IMAGE": f"{self.registry}/ros:jazzy"},
        }
        job = {"plugin": "rigel_k8s.BuildXPlugin", "with": options}
        whole = {"application": {"distro": "jazzy"}, "jobs": {"build": job}}
        (self.directory / "Rigelfile").write_text(yaml.safe_dump(whole, sort_keys=False))
        self.rigel("run", "job", "build")
        return f"{self.registry}/{name}"

    def until(self, workload: str, found: Callable[[str], Any], seconds: float = 600) -> Any:
        """Wait until a workload's log has something, and return it."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if result := found(self.kubectl("logs", f"deployment/{workload}", "--tail=-1")):
                return result
            time.sleep(0.5)
        raise SystemExit(f"{workload} has printed no result in {seconds:.0f} s")


def rigel(*words: str) -> None:
    """Run rigel and show its output."""
    subprocess.run([sys.executable, "-m", "rigel_k8s", *words], check=True)


def main() -> None:
    """Measure and print."""
    words = arguments()
    name = words.context.removeprefix("rigel-")
    if words.context == OWN:
        rigel("cluster", "up", "--name", name, "--nodes", "3", *EXTRAS)
        rigel("--context", OWN, "network", "install")
    status = lab.status(name)
    only = words.only.split(",")
    with tempfile.TemporaryDirectory() as directory:
        bench = Bench(words.context, status.kubectl, status.registry, Path(directory))
        base = [sys.executable, "-m", "rigel_lab", "ros2-base"]
        subprocess.run([*base, "--push", f"{status.registry}/ros:jazzy"], check=True)
        image = bench.image("bench-ros2", NODES)
        if "discovery" in only:
            show(discovery(bench, image, [int(n) for n in words.members.split(",")]))
        if "flow" in only:
            show(flow(bench, image, words.rounds))
        if "first" in only:
            show(first(bench, words.rounds))
        bench.kubectl("delete", "ns", SPACE, "--ignore-not-found", "--wait=false")


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.ros2", description=__doc__)
    parser.add_argument("--only", default="discovery,flow,first")
    parser.add_argument("--members", default="2,20,50", help="how many participants")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--context", default=OWN, help="of a cluster of `rigel cluster`")
    return parser.parse_args()


def show(rows: Iterator[str]) -> None:
    """Print a table as it grows."""
    print(flush=True)
    for row in rows:
        print(row, flush=True)


def discovery(bench: Bench, image: str, members: list[int]) -> Iterator[str]:
    """Yield how long a new participant takes until it has discovered all others, by mode."""
    heads = "data flows, s | slowest | / macvlan | names known, s | slowest | found all within 30 s"
    yield f"| participants | mode | {heads} |"
    yield "|---|---|---|---|---|---|---|---|"
    for count in members:
        own = 0.0
        for mode, network in MODES.items():
            everyone = measure_joins(bench, image, network, count)
            joins = [one for one in everyone if None not in one]
            complete = f"{len(joins)} of {len(everyone)}"
            flows, names = ([one[i] for one in joins] for i in (0, 1))
            own = own or median(flows)
            ratio = median(flows) / own
            found = f"{median(flows):.2f} | {max(flows):.2f} | {ratio:.1f}"
            graph = f"{median(names):.2f} | {max(names):.2f} | {complete}"
            yield f"| {count} | {mode} | {found} | {graph} |"


def measure_joins(
    bench: Bench, image: str, network: dict[str, Any], count: int
) -> list[list[float]]:
    """Deploy so many participants and return the seconds, two each, of those that joined them."""
    idle = {"args": ["member.py"], "readiness": "none"}  # whose probes cost what is measured
    nodes: dict[str, Any] = {f"member_{n:02}": dict(idle) for n in range(count - 1)}
    joins = "15" if count < MANY else "7"
    nodes["asking"] = {**idle, "env": {"MEMBERS": str(count), "JOINS": joins}}
    bench.fresh()
    bench.write(network, nodes, image)
    bench.deploy()
    found = bench.until("asking", lambda log: re.search(r'^\{"joins".*\}$', log, re.M))
    joined: list[list[float]] = json.loads(found[0])["joins"]
    if all(None in one for one in joined):
        raise SystemExit(
            f"{network['mode']}, {count}: no participant discovered all others: {joined}"
        )
    return joined


def flow(bench: Bench, image: str, rounds: int) -> Iterator[str]:
    """Yield latency and loss of small and large messages between two machines, by mode."""
    figures: dict[tuple[str, int], list[dict[str, Any]]] = {}
    modes = {name: MODES[name] for name in ("macvlan", "peers", "host")}
    for _ in range(rounds):
        for mode, network in modes.items():
            for figure in measure_flow(bench, image, network):
                figures.setdefault((mode, figure["size"]), []).append(figure)
    yield "| message | mode | median ms | 99 % ms | lost % | median / macvlan |"
    yield "|---|---|---|---|---|---|"
    for size in (100, 1_000_000):
        own = median([one["latency"][0] for one in figures["macvlan", size]])
        for mode in modes:
            runs = figures[mode, size]
            middle, tail = (median([one["latency"][i] for one in runs]) for i in (0, 1))
            lost = 100 * (1 - sum(r["received"] for r in runs) / sum(r["sent"] for r in runs))
            found = f"{middle:.2f} | {tail:.2f} | {lost:.1f} | {middle / own:.2f}"
            yield f"| {size} B | {mode} | {found} |"


def measure_flow(bench: Bench, image: str, network: dict[str, Any]) -> list[dict[str, Any]]:
    """Deploy a source and a sink on two machines and return the sink's results."""
    nodes = {
        "source": {"args": ["flow.py", "source"]},
        "sink": {"args": ["flow.py", "sink"], "placement": {"apart_from": ["source"]}},
    }
    bench.fresh()
    bench.write(network, nodes, image)
    bench.rigel("run", "job", "deploy")

    def both(log: str) -> list[dict[str, Any]]:
        results = [json.loads(line) for line in log.splitlines() if line.startswith('{"size"')]
        return results if len(results) == 2 else []

    return list(bench.until("sink", both))


def first(bench: Bench, rounds: int) -> Iterator[str]:
    """Yield the time to the first message at the listener: rigel, kubectl with its manifests."""
    image = bench.image("bench-ros2-example", EXAMPLE)
    talker = {"args": ["talker.py"], "parameters": {"rate": 20.0}}
    listener = {"args": ["listener.py"], "placement": {"apart_from": ["talker_1", "talker_2"]}}
    nodes = {"talker_1": talker, "talker_2": talker, "listener": listener}
    found: dict[str, list[tuple[float, float]]] = {"rigel": [], "kubectl": []}
    loads = []
    ways = {"rigel": by_rigel, "kubectl": by_kubectl}
    for _ in range(rounds):
        for name, way in ways.items():
            bench.fresh()
            bench.write(MODES["macvlan"], nodes, image)
            found[name].append(heard(bench, way(bench)))
            loads.append(os.getloadavg()[0])
    yield "| deployed by | first message, s | the command ends, s | first / kubectl |"
    yield "|---|---|---|---|"
    own = median([one for one, _ in found["kubectl"]])
    for name, runs in found.items():
        message, end = (median([run[i] for run in runs]) for i in (0, 1))
        yield f"| {name} | {message:.2f} | {end:.2f} | {message / own:.2f} |"
    yield f"load of {os.cpu_count()} cores: {min(loads):.0f} to {max(loads):.0f}"


def heard(bench: Bench, deploy: Callable[[], object]) -> tuple[float, float]:
    """Deploy; return the seconds to the first message and to the command's end."""
    started = time.time()
    deploy()
    ended = time.time()
    line = bench.until("listener", FIRST.search)
    return float(line[1]) - started, ended - started


def by_rigel(bench: Bench) -> Callable[[], object]:
    """`rigel run job deploy`, which ends after the check of the graph."""
    return lambda: bench.rigel("run", "job", "deploy")


def by_kubectl(bench: Bench) -> Callable[[], object]:
    """`kubectl apply` of what rigel would apply, rendered before, and `kubectl rollout status`."""
    rendered = bench.rigel("render", "deploy")
    selector = ["-l", "app.kubernetes.io/managed-by=rigel", "--timeout=600s"]

    def deploy() -> None:
        bench.kubectl("apply", "--server-side", "-f", "-", text=rendered)
        bench.kubectl("rollout", "status", "deployment", *selector)

    return deploy


if __name__ == "__main__":
    main()

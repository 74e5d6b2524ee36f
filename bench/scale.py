"""Many ROS nodes in one release, and many releases, beside kubectl and helm; prints a table.

usage: python -m bench.scale --context rigel-NAME [--nodes 100,300,1000] [--releases 1,10,100]
                             [--tools rigel,kubectl,helm] [--per-release 5]

Pods run on machines that exist only in the API (bench/fakenodes.py), which need a cluster of their
own: its real machines take no pods meanwhile. With --releases each release is a robot in a
namespace of its own; rigel deploys them by one sequence in waves, the other tools one by one.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs

from bench.__main__ import NODE, tag_again
from bench.fakenodes import fake_machines
from bench.measure import Sample, run
from bench.tools import helm_program, program
from rigel_lab import cluster as localcluster

Command = Sequence[str]
STEPS = ("first deploy", "unchanged", "one image", "status", "down")
MACHINES = 20
WAVE = 10
RIGELFILE = """\
application: {{ distro: noetic }}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: "{{{{ data.robot }}}}"
      deploy_ros_master: false
      ros_master_uri: http://robot:11311
      nodes:
{nodes}
sequences:
  fleet:
    stages:
      - parallel: [{{ jobs: [deploy] }}]
        matrix: {{ robot: {robots}, max_parallel: [{wave}] }}
"""


@attrs.frozen
class Fleet:
    """Releases of one size, each in its namespace, and how to reach their cluster."""

    context: str
    kubectl: str
    registry: str
    directory: Path
    nodes: int
    robots: tuple[str, ...]

    def write(self, name: str, *, changed: bool = False) -> Path:
        """Write the Rigelfile; `changed` gives each release's first node another image."""
        nodes = "".join(
            NODE.format(index=n, registry=self.registry, tag=2 if changed and n == 0 else 1)
            for n in range(self.nodes)
        )
        path = self.directory / name
        text = RIGELFILE.format(nodes=nodes, robots=list(self.robots), wave=WAVE)
        path.write_text(text)
        return path

    def on(self, robot: str) -> list[str]:
        """Return kubectl's command line for a robot."""
        return [self.kubectl, "--context", self.context, "-n", robot]

    def render(self, robot: str, *, changed: bool) -> str:
        """Return a robot's manifests."""
        path = self.write("render", changed=changed)
        path.write_text(path.read_text().replace("{{ data.robot }}", robot))
        command = [*program(), "-f", str(path), "--context", self.context, "render", "deploy"]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def rigel(fleet: Fleet) -> dict[str, list[Command]]:
    """Return what rigel runs for each step."""
    plain, changed = fleet.write("plain"), fleet.write("changed", changed=True)
    head = [*program(), "--context", fleet.context, "-q"]
    deploy = ["run", "sequence", "fleet", "--timeout", "30m"]
    return {
        "first deploy": [[*head, "-f", str(plain), *deploy]],
        "unchanged": [[*head, "-f", str(plain), *deploy]],
        "one image": [[*head, "-f", str(changed), *deploy]],
        "status": [[*head, "list", "-A"]]
        if len(fleet.robots) > 1
        else [[*head, "status", "--no-graph", "-n", fleet.robots[0], "rigel-k8s-application"]],
        "down": [[*head, "down", "-n", r, "rigel-k8s-application"] for r in fleet.robots],
    }


def kubectl(fleet: Fleet) -> dict[str, list[Command]]:
    """Return what kubectl runs for each step."""
    files = {changed: manifests(fleet, changed=changed) for changed in (False, True)}
    selector = ["-l", "app.kubernetes.io/managed-by=rigel"]

    def deploy(*, changed: bool) -> list[Command]:
        wait = ["rollout", "status", "deployment", *selector, "--timeout=1800s"]
        return [
            [*fleet.on(robot), *words]
            for robot, path in files[changed].items()
            for words in (["apply", "--server-side", "-f", str(path)], wait)
        ]

    return {
        "first deploy": deploy(changed=False),
        "unchanged": deploy(changed=False),
        "one image": deploy(changed=True),
        "status": [
            [*fleet.on(robot), "get", "deployments,pods", *selector] for robot in files[True]
        ],
        "down": [
            [*fleet.on(robot), "delete", "--wait", "-f", str(path)]
            for robot, path in files[True].items()
        ],
    }


def manifests(fleet: Fleet, *, changed: bool) -> dict[str, Path]:
    """Write each robot's manifests; return their files."""
    found = {}
    for robot in fleet.robots:
        found[robot] = fleet.directory / f"{robot}-{changed}.yaml"
        found[robot].write_text(fleet.render(robot, changed=changed))
    return found


def helm(fleet: Fleet) -> dict[str, list[Command]]:
    """Return what helm runs for each step: a chart for each robot with its manifests."""
    tool, charts = helm_program(), {}
    for changed in (False, True):
        for robot, path in manifests(fleet, changed=changed).items():
            chart = path.with_suffix(".chart")
            (chart / "templates").mkdir(parents=True)
            (chart / "files").mkdir()
            (chart / "Chart.yaml").write_text("apiVersion: v2\nname: bench\nversion: 0.1.0\n")
            (chart / "files" / "all.yaml").write_text(path.read_text())
            (chart / "templates" / "all.yaml").write_text('{{ .Files.Get "files/all.yaml" }}\n')
            charts[robot, changed] = chart

    def each(*words: str, changed: bool | None = None) -> list[Command]:
        chart = (lambda r: []) if changed is None else (lambda r: [str(charts[r, changed])])
        return [
            [tool, "--kube-context", fleet.context, "-n", robot, *words, "bench", *chart(robot)]
            for robot in fleet.robots
        ]

    deploy = ("upgrade", "--install", "--wait", "--timeout", "1800s")
    return {
        "first deploy": each(*deploy, changed=False),
        "unchanged": each(*deploy, changed=False),
        "one image": each(*deploy, changed=True),
        "status": each("status"),
        "down": each("uninstall", "--wait", "--timeout", "1800s"),
    }


TOOLS = {"rigel": rigel, "kubectl": kubectl, "helm": helm}


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m bench.scale", description=__doc__)
    parser.add_argument("--context", required=True, help="of a cluster of `rigel cluster`")
    parser.add_argument("--nodes", default="100,300,1000")
    parser.add_argument("--releases", default="1,10,100")
    parser.add_argument("--per-release", type=int, default=5, help="nodes of a fleet's robots")
    parser.add_argument("--tools", default="rigel,kubectl,helm")
    words = parser.parse_args()
    status = localcluster.status(words.context.removeprefix("rigel-"))
    tag_again(status.registry)
    host = re.sub(r"\d+:\d+$", "1", status.registry)
    shapes = [(int(nodes), 1) for nodes in words.nodes.split(",") if nodes]
    shapes += [(words.per_release, int(robots)) for robots in words.releases.split(",") if robots]
    with fake_machines([status.kubectl, "--context", words.context], MACHINES, host):
        print("| releases | nodes of each | step | tool | wall s | cpu s | MiB | ms a node |")
        print("|---|---|---|---|---|---|---|---|")
        for nodes, robots in shapes:
            for tool in words.tools.split(","):
                for row in measure(words.context, status, nodes, robots, tool):
                    print(row, flush=True)


def measure(
    context: str, status: localcluster.ClusterStatus, nodes: int, robots: int, tool: str
) -> Iterator[str]:
    """Yield the rows of one tool for one shape of a fleet."""
    names = tuple(f"scale-{tool}-{nodes}-{number}" for number in range(robots))
    with tempfile.TemporaryDirectory() as directory:
        fleet = Fleet(context, status.kubectl, status.registry, Path(directory), nodes, names)
        for name in names:
            subprocess.run([*fleet.on(name), "create", "ns", name], check=True, capture_output=True)
        try:
            commands = TOOLS[tool](fleet)
            for step in STEPS:
                yield row(fleet, step, tool, run(*commands[step]))
        finally:
            gone = [*fleet.on("default"), "delete", "ns", *names, "--wait=false"]
            subprocess.run(gone, check=False, capture_output=True)


def row(fleet: Fleet, step: str, tool: str, sample: Sample) -> str:
    """Return one row of the table."""
    each = 1000 * sample.wall / fleet.nodes / len(fleet.robots)
    figures = f"{sample.wall:.2f} | {sample.cpu:.2f} | {sample.memory:.0f} | {each:.1f}"
    return f"| {len(fleet.robots)} | {fleet.nodes} | {step} | {tool} | {figures} |"


if __name__ == "__main__":
    main()

"""Fleets of robots beside kubectl and helm, each robot a release in a namespace; prints a table.

usage: python -m bench.fleets --context rigel-NAME [--robots 1,10] [--nodes 5]
                              [--tools rigel,kubectl,helm] [--limit 1800]

rigel deploys and deletes a fleet by one sequence, the other tools one robot after the other. A step
that fails, or takes longer than the limit, is marked in the table, and the run continues; the
command's output goes to standard error.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import attrs

from bench.__main__ import NODE, tag_again
from bench.measure import CommandFailed, Sample, TooSlow, run
from bench.tools import helm_program, program
from rigel_lab import cluster as lab

Command = Sequence[str]
STEPS = ("first deploy", "unchanged", "one image", "status", "down")
WAVE = 10
#: Placeholder for a robot's name in manifests that are rendered once for all robots.
ROBOT = "robot-of-the-fleet"
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

    def to_cluster(self, tool: str = "") -> list[str]:
        """Return the options of rigel and kubectl that choose the cluster, or those of helm."""
        return ["--kube-context" if tool == "helm" else "--context", self.context]

    def on(self, robot: str) -> list[str]:
        """Return kubectl's command line for a robot."""
        return [self.kubectl, *self.to_cluster(), "-n", robot]

    def render(self, *, changed: bool) -> str:
        """Return the manifests of a robot named ROBOT."""
        path = self.write("render", changed=changed)
        path.write_text(path.read_text().replace("{{ data.robot }}", ROBOT))
        command = [*program(), "-f", str(path), *self.to_cluster(), "render", "deploy"]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def rigel(fleet: Fleet) -> dict[str, list[Command]]:
    """Return rigel's commands for each step."""
    plain, changed = fleet.write("plain"), fleet.write("changed", changed=True)
    head = [*program(), *fleet.to_cluster(), "-q"]
    deploy = ["run", "sequence", "fleet", "--timeout", "30m"]
    return {
        "first deploy": [[*head, "-f", str(plain), *deploy]],
        "unchanged": [[*head, "-f", str(plain), *deploy]],
        "one image": [[*head, "-f", str(changed), *deploy]],
        "status": [[*head, "list", "-A"]]
        if len(fleet.robots) > 1
        else [[*head, "status", "--no-graph", "-n", fleet.robots[0], "rigel-k8s-application"]],
        "down": [[*head, "-f", str(plain), "down", "--sequence", "fleet"]],
    }


def kubectl(fleet: Fleet) -> dict[str, list[Command]]:
    """Return kubectl's commands for each step."""
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
    found, text = {}, fleet.render(changed=changed)
    for robot in fleet.robots:
        found[robot] = fleet.directory / f"{robot}-{changed}.yaml"
        found[robot].write_text(text.replace(ROBOT, robot))
    return found


def helm(fleet: Fleet) -> dict[str, list[Command]]:
    """Return helm's commands for each step: a chart for each robot with its manifests."""
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
            [tool, *fleet.to_cluster("helm"), "-n", robot, *words, "bench", *chart(robot)]
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


@attrs.frozen
class Outcome:
    """The costs of a tool's step.

    Attributes:
        failure: what the table says instead of the figures, empty where the step succeeded.
        sample: None where the step failed.
    """

    failure: str = ""
    sample: Sample | None = None


def measure(fleet: Fleet, tool: str, limit: float) -> Iterator[tuple[str, Outcome]]:
    """Yield the steps of one tool and their costs; a step that is too slow is the last."""
    commands = TOOLS[tool](fleet)
    for step in STEPS:
        try:
            outcome = Outcome("", run(*commands[step], limit=limit))
        except TooSlow:
            outcome = Outcome(f"over {limit:g} s")
        except CommandFailed as error:
            print(error, file=sys.stderr, flush=True)
            outcome = Outcome("failed")
        print(f"{len(fleet.robots)} {tool} {step}: {outcome}", file=sys.stderr, flush=True)
        yield step, outcome
        if outcome.failure.startswith("over"):
            return


@contextlib.contextmanager
def namespaces(kubectl: Sequence[str], names: Sequence[str]) -> Iterator[None]:
    """Create namespaces, and delete them with everything in them."""
    try:
        for name in names:
            subprocess.run([*kubectl, "create", "ns", name], check=True, capture_output=True)
        yield
    finally:
        gone = [*kubectl, "delete", "ns", *names, "--ignore-not-found", "--timeout=600s"]
        subprocess.run(gone, check=False, capture_output=True)


def describe(outcomes: Sequence[Outcome | None]) -> str:
    """Return the cells of a row: in each the tools' figures, in the order of the tools."""
    rows = [
        [f"{one.sample.wall:.1f}", f"{one.sample.cpu:.2f}", f"{one.sample.memory:.0f}"]
        if one and one.sample
        else [one.failure if one else "-", "-", "-"]
        for one in outcomes
    ]
    return " | ".join(" / ".join(cell) for cell in zip(*rows, strict=True))


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m bench.fleets", description=__doc__)
    parser.add_argument("--context", required=True, help="of a cluster of `rigel cluster`")
    parser.add_argument("--robots", default="1,10")
    parser.add_argument("--nodes", type=int, default=5, help="ROS nodes of each robot")
    parser.add_argument("--tools", default="rigel,kubectl,helm")
    parser.add_argument("--limit", type=float, default=1800, help="seconds that a step may take")
    words = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    status = lab.status(words.context.removeprefix("rigel-"))
    tag_again(status.registry)
    tools = words.tools.split(",")
    print(f"Cells: {' / '.join(tools)}")
    print("| robots | step | wall s | cpu s | MiB |\n|---|---|---|---|---|")
    for robots in map(int, words.robots.split(",")):
        found = []
        for tool in tools:
            names = tuple(f"fleet-{tool}-{number}" for number in range(robots))
            kubectl = [status.kubectl, "--context", words.context]
            with tempfile.TemporaryDirectory() as directory, namespaces(kubectl, names):
                fleet = Fleet(
                    words.context,
                    status.kubectl,
                    status.registry,
                    Path(directory),
                    words.nodes,
                    names,
                )
                found.append(dict(measure(fleet, tool, words.limit)))
        for step in STEPS:
            cells = describe([by_step.get(step) for by_step in found])
            print(f"| {robots} | {step} | {cells} |", flush=True)


if __name__ == "__main__":
    main()

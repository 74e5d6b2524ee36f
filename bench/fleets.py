"""Fleets of robots, each a release in a namespace of its own, and each tool's commands for them.

rigel deploys and deletes a fleet by one sequence, the other tools one robot after the other.
"""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

import attrs

from bench.__main__ import NODE
from bench.tools import helm_program, program

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
    kubeconfig: Path
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
        context = "--kube-context" if tool == "helm" else "--context"
        return ["--kubeconfig", str(self.kubeconfig), context, self.context]

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

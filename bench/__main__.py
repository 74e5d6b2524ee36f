"""Compares deploys on one cluster, with the same objects, images and readiness; prints ratios.

usage: python -m bench [--nodes 1,20,100] [--runs 3] [--context NAME] [--before CHECKOUT]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.measure import Figure, run
from bench.tools import Helm, Kubectl, Rigel, Tool, helm_program, program
from rigel_lab import cluster as lab

SCENARIOS = ("first deploy", "unchanged", "one image")
RIGELFILE = """\
application: {{ distro: noetic }}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      deploy_ros_master: false
      ros_master_uri: http://robot:11311
      nodes:
{nodes}
"""
NODE = """\
        node_{index:03}:
          image: {registry}/rigel-k8s/pause:{tag}
          command: [/catatonit, -P]
          readiness: none
          parameters: {{}}
"""


def main() -> None:
    """Measure and print."""
    words = arguments()
    name = words.context.removeprefix("rigel-")
    if words.context == "rigel-bench":
        lab.up(name, 2, extras=["kubectl"], report=print)
    status = lab.status(name)
    tools: list[Tool] = [
        Rigel(words.context),
        Kubectl(words.context, status.kubectl),
        Helm(words.context, helm_program()),
    ]
    if words.before:
        tools.append(Rigel(words.context, "bench-before", "rigel before", words.before.resolve()))
    kubectl = [status.kubectl, "--context", words.context]
    tag_again(status.registry)
    with tempfile.TemporaryDirectory() as directory:
        start_up(Path(directory), words.runs, status.registry, words.before)
        print("\n| nodes | deploy | tool | wall s | cpu s | MiB | rigel / tool (wall) |")
        print("|---|---|---|---|---|---|---|")
        for count in map(int, words.nodes.split(",")):
            for row in deploys(Path(directory), kubectl, tools, count, words.runs, status.registry):
                print(row, flush=True)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument("--nodes", default="1,20,100", help="how many ROS nodes, comma-separated")
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--context", default="rigel-bench", help="of a cluster of `rigel cluster`")
    parser.add_argument("--before", type=Path, help="another checkout of rigel to compare with")
    return parser.parse_args()


def tag_again(registry: str) -> None:
    """Give the pause image a second tag with other content, for the one-image update."""
    from rigel_lab.cluster import components, oci

    parts = components.obtain(print)
    files = {"catatonit": Path(parts.program("catatonit")), "second": "second\n"}
    oci.push(oci.Image("rigel-k8s/pause:2", files, ["/catatonit", "-P"]), registry)


def write(path: Path, count: int, registry: str, *, changed: bool = False) -> Path:
    """Write a Rigelfile of so many nodes; `changed` gives the first one another image."""
    nodes = "".join(
        NODE.format(index=i, registry=registry, tag=2 if changed and i == 0 else 1)
        for i in range(count)
    )
    path.write_text(RIGELFILE.format(nodes=nodes))
    return path


def deploys(
    directory: Path, kubectl: list[str], tools: list[Tool], count: int, runs: int, registry: str
) -> Iterator[str]:
    """Yield the table's rows for one number of nodes."""
    figures = {(s, t.name): Figure() for s in SCENARIOS for t in tools}
    plain = write(directory / f"plain-{count}", count, registry)
    changed = write(directory / f"changed-{count}", count, registry, changed=True)
    for _ in range(runs):
        for tool in tools:
            fresh_namespace(kubectl, tool.namespace)
            for scenario, rigelfile in zip(SCENARIOS, (plain, plain, changed), strict=True):
                sample = run(*tool.deploy(rigelfile))
                figures[scenario, tool.name].samples.append(sample)
            subprocess.run(
                [*kubectl, "delete", "ns", tool.namespace, "--wait"],
                check=True,
                stdout=subprocess.DEVNULL,
            )
    for scenario in SCENARIOS:
        own = figures[scenario, "rigel"].median("wall")
        for tool in tools:
            yield row(count, scenario, tool.name, figures[scenario, tool.name], own)


def fresh_namespace(kubectl: list[str], name: str) -> None:
    """Make an empty namespace; one left by a bench that was interrupted is removed first."""
    subprocess.run(
        [*kubectl, "delete", "ns", name, "--ignore-not-found", "--wait"],
        check=True,
        stdout=subprocess.DEVNULL,
    )
    subprocess.run([*kubectl, "create", "ns", name], check=True, stdout=subprocess.DEVNULL)


def row(count: int, scenario: str, tool: str, figure: Figure, own: float) -> str:
    """Return one row of the table."""
    wall = figure.median("wall")
    ratio = "" if tool == "rigel" else f"{own / wall:.2f}"
    cpu, memory = figure.median("cpu"), figure.median("memory")
    return f"| {count} | {scenario} | {tool} | {wall:.2f} | {cpu:.2f} | {memory:.0f} | {ratio} |"


def start_up(directory: Path, runs: int, registry: str, before: Path | None) -> None:
    """Print the costs of the command's start."""
    rigelfile = str(write(directory / "check-100", 100, registry))
    python = [sys.executable, "-c"]
    commands = {
        "python -c pass": [*python, "pass"],
        "python -c 'import click'": [*python, "import click"],
    }
    checkouts = {"rigel": None, **({"rigel before": before.resolve()} if before else {})}
    for name, checkout in checkouts.items():
        commands[f"{name} --help"] = [*program(checkout), "--help"]
        here = [*program(checkout), "-f", rigelfile]
        commands[f"{name} check (100 nodes)"] = [*here, "check"]
        commands[f"{name} render (100 nodes)"] = [*here, "render", "deploy"]
    figures = {name: Figure() for name in commands}
    for _ in range(max(runs, 7)):
        for name, command in commands.items():
            figures[name].samples.append(run(command))
    bare = figures["python -c pass"].median("wall")
    print("\n| command | wall s | / python -c pass |\n|---|---|---|")
    for name, figure in figures.items():
        wall = figure.median("wall")
        print(f"| {name} | {wall:.3f} | {wall / bare:.1f} |")


if __name__ == "__main__":
    main()

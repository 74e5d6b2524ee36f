"""Many ROS nodes in one release, and many releases, beside kubectl and helm; prints a table.

usage: python -m bench.scale --context rigel-NAME [--nodes 100,300,1000] [--releases 1,10,100]
                             [--tools rigel,kubectl,helm] [--per-release 5] [--limit 1800]

Pods run on machines that exist only in the API (bench/fakenodes.py), which need a cluster of their
own: its real machines take no pods meanwhile. A step that fails, or takes longer than the limit,
is marked in the table, and the run continues; the command's output goes to standard error.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import attrs

from bench.__main__ import tag_again
from bench.fakenodes import fake_machines
from bench.fleets import STEPS, TOOLS, Fleet
from bench.measure import CommandFailed, Sample, TooSlow, run
from bench.requests import CountedUser, counted_user
from rigel_lab import cluster as lab

MACHINES = 20


@attrs.frozen
class Shape:
    """The size of a fleet."""

    robots: int
    nodes: int


@attrs.frozen
class Outcome:
    """The costs of a tool's step.

    Attributes:
        failure: what the table says instead of the figures, empty where the step succeeded.
        sample: None where the step failed.
    """

    failure: str = ""
    sample: Sample | None = None
    requests: int = 0


@attrs.frozen
class Bench:
    """The cluster for the measurement, and the seconds that a step may take."""

    context: str
    status: lab.ClusterStatus
    user: CountedUser
    limit: float

    def measure(self, shape: Shape, tool: str) -> Iterator[tuple[str, Outcome]]:
        """Yield the steps of one tool and their costs; a step that is too slow is the last."""
        names = [f"scale-{tool}-{shape.nodes}-{number}" for number in range(shape.robots)]
        with tempfile.TemporaryDirectory() as directory, self.namespaces(names):
            fleet = Fleet(
                self.context,
                self.user.kubeconfig,
                self.status.kubectl,
                self.status.registry,
                Path(directory),
                shape.nodes,
                tuple(names),
            )
            commands = TOOLS[tool](fleet)
            for step in STEPS:
                before = self.user.count()
                try:
                    sample = run(*commands[step], limit=self.limit)
                except TooSlow:
                    yield step, Outcome(f"over {self.limit:g} s")
                    return
                except CommandFailed as error:
                    print(error, file=sys.stderr, flush=True)
                    yield step, Outcome("failed")
                else:
                    yield step, Outcome("", sample, self.user.count() - before)

    @contextlib.contextmanager
    def namespaces(self, names: list[str]) -> Iterator[None]:
        """Create namespaces, and delete them with everything in them."""
        kubectl = [self.status.kubectl, "--context", self.context]
        try:
            for name in names:
                subprocess.run([*kubectl, "create", "ns", name], check=True, capture_output=True)
            yield
        finally:
            gone = [*kubectl, "delete", "ns", *names, "--ignore-not-found", "--timeout=600s"]
            subprocess.run(gone, check=False, capture_output=True)


def main() -> None:
    """Measure and print."""
    words = arguments()
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    status = lab.status(words.context.removeprefix("rigel-"))
    kubectl = [status.kubectl, "--context", words.context]
    tag_again(status.registry)
    host = re.sub(r"\d+:\d+$", "1", status.registry)
    tools = words.tools.split(",")
    shapes = [Shape(1, int(nodes)) for nodes in words.nodes.split(",") if nodes]
    shapes += [Shape(int(n), words.per_release) for n in words.releases.split(",") if n]
    with (
        fake_machines(kubectl, MACHINES, host),
        tempfile.TemporaryDirectory() as directory,
        counted_user(kubectl, Path(directory)) as user,
    ):
        bench = Bench(words.context, status, user, words.limit)
        print(f"Cells: {' / '.join(tools)}")
        print(
            "| releases | nodes of each | step | wall s | cpu s | MiB | requests | cpu ms a node |"
        )
        print("|---|---|---|---|---|---|---|---|")
        for shape in shapes:
            found = {tool: dict(follow(bench, shape, tool)) for tool in tools}
            for step in STEPS:
                row = describe(shape, [by_step.get(step) for by_step in found.values()])
                print(f"| {shape.robots} | {shape.nodes} | {step} | {row} |", flush=True)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.scale", description=__doc__)
    parser.add_argument("--context", required=True, help="of a cluster of `rigel cluster`")
    parser.add_argument("--nodes", default="100,300,1000")
    parser.add_argument("--releases", default="1,10,100")
    parser.add_argument("--per-release", type=int, default=5, help="nodes of a fleet's robots")
    parser.add_argument("--tools", default="rigel,kubectl,helm")
    parser.add_argument("--limit", type=float, default=1800, help="seconds that a step may take")
    return parser.parse_args()


def follow(bench: Bench, shape: Shape, tool: str) -> Iterator[tuple[str, Outcome]]:
    """Yield the steps as they are measured, with a line for each on standard error."""
    for step, outcome in bench.measure(shape, tool):
        print(f"{shape} {tool} {step}: {outcome}", file=sys.stderr, flush=True)
        yield step, outcome


def describe(shape: Shape, outcomes: list[Outcome | None]) -> str:
    """Return the cells of a row: in each the tools' figures, in the order of the tools."""
    rows = [figures(shape, outcome) for outcome in outcomes]
    return " | ".join(" / ".join(cell) for cell in zip(*rows, strict=True))


def figures(shape: Shape, outcome: Outcome | None) -> list[str]:
    """Return one tool's figures of a step, `-` if it was not run or has failed."""
    if outcome is None or outcome.sample is None:
        return [outcome.failure if outcome else "-", *"----"]
    sample, nodes = outcome.sample, shape.robots * shape.nodes
    return [
        f"{sample.wall:.1f}",
        f"{sample.cpu:.2f}",
        f"{sample.memory:.0f}",
        str(outcome.requests),
        f"{1000 * sample.cpu / nodes:.1f}",
    ]


if __name__ == "__main__":
    main()

"""graph: the live ROS graph of a release, with rates if they are measured."""

from __future__ import annotations

import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import attrs

from rigel_graph.drawing import Picture, make_picture
from rigel_graph.problems import find_problems
from rigel_graph.reading import read_graph
from rigel_graph.types import RosGraph
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.commands.top import TOPICS, ask_prometheus, index_by
from rigel_k8s.errors import ClusterError, CommandFailed
from rigel_k8s.observability.reading.stack import NoStack
from rigel_k8s.problems import Problem
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from rigel_k8s.system.process import run

PAINTING = 60.0  # seconds that Graphviz may take


@attrs.frozen
class LiveGraph:
    """A release's current graph, and what is wrong in it."""

    release: ReleaseId
    graph: RosGraph
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        return not any(problem.is_error for problem in self.problems)


def graph(settings: Settings, job: str | None) -> LiveGraph:
    """Return a release's graph.

    Raises:
        UserError: nothing of the release is on the cluster.
        ClusterError: the graph cannot be read.
    """
    found = release(settings, job)
    with found.cluster:
        return look(found)


def look(found: Release) -> LiveGraph:
    """Return the graph of a release that is connected. Raises as graph."""
    read = read_graph(found.cluster, found.id)
    if any(topic.rate is None for topic in read.topics):
        read = read.with_rates(measure_rates(found))
    return LiveGraph(found.id, read, find_problems(read))


def measure_rates(found: Release) -> dict[str, float]:
    """Return messages per second by topic, from Prometheus; empty without one."""
    try:
        samples = ask_prometheus(found, {name: TOPICS[name] for name in ("counted", "heard")})
    except (NoStack, ClusterError):
        return {}
    return index_by("topic", (*samples["counted"], *samples["heard"]))


def paint(dot: str, form: str, to: Path) -> None:
    """Let Graphviz write a DOT document as a picture.

    Args:
        form: `svg`, `png`, `pdf`, or another one of Graphviz's.

    Raises:
        CommandFailed: Graphviz is not installed, or failed.
    """
    if shutil.which("dot") is None:
        raise CommandFailed(
            "pictures are drawn by Graphviz, and its program dot is not installed",
            hint="install graphviz (apt, dnf, brew), or print the graph for another"
            " machine's Graphviz: rigel graph -o dot; `rigel ui` needs neither",
        )
    with TemporaryDirectory() as folder:
        source = Path(folder, "graph.dot")
        source.write_text(dot, encoding="utf-8")
        run(["dot", f"-T{form}", f"-o{to}", str(source)], what="dot", timeout=PAINTING)


def picture_of(found: LiveGraph, *, everything: bool = False) -> Picture:
    """Return what a picture shows; `everything`: also what each node has, such as its log topic."""
    title = f"{found.release.name} in {found.release.namespace}"
    return make_picture(found.graph, found.problems, title=title, everything=everything)

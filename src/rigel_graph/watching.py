"""Compares a release's ROS graph before and after an update: `GraphWatch`.

Why: a deploy is over when its pods are ready, and yet a topic may have lost its publisher. The
graph is read only when an update replaces pods, before its first write and after its roll-out. If
old nodes of ROS 2 work until new ones, which wait, take over, it is read while these start. Nodes
need a moment to register and to be discovered again, so a worse graph is read again until it is
better or the patience is over. When a roll-out is over, the new pods are ready, but the old ones
may still be ending. Until they have, the graph has their publishers, so they are waited for. This
module is independent of application options; its caller decides what to do about a worse graph. The
readers of a graph are imported when one is read: a deploy that changes nothing reads none.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TYPE_CHECKING, Any

import attrs

from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION, denies_ros
from rigel_k8s.objects.podnodes import split
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.text import plural
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.revisions import find_last_good
from rigel_k8s.release.types import Plan, ReleaseId, Step
from rigel_k8s.report import Reporter

if TYPE_CHECKING:
    from rigel_exporter.expecting import Expected
    from rigel_graph.comparison import Comparison
    from rigel_graph.expectations import Verdict
    from rigel_graph.reading import Listed
    from rigel_graph.types import RosGraph

PATIENCE = 20.0  # seconds that nodes have to be in the graph again after an update
LEAVING = 60.0  # seconds that the previous pods have to end; Kubernetes gives them 30 by default
AGAIN = 1.0  # seconds between two looks
SOON = 0.3  # the same at pods that are being terminated
MOMENT = 5.0  # seconds that nodes have for their topics in a first deploy
MOST = 20  # lines of a report
#: Problems that names or types cause which do not fit.
MISFITS = ("no-publisher", "type")
#: A variable of containers whose nodes wait for the old ones, and take over.
HANDS_OVER = "RIGEL_K8S_PEERS"
WORKLOADS = ("DaemonSet", "Deployment", "StatefulSet")


class GraphWorse(RigelK8sError):
    """An update is rolled out, and the ROS graph is worse than before; see `details`."""


@attrs.define
class GraphWatch:
    """One deploy of a release, watched: `begin`, the roll-out, then `report`.

    Attributes:
        last_good: the revision that was good when the update began, None without one.
        patience: seconds that the graph may stay worse after the roll-out.
        expected: of topics. An update that breaks it makes the graph worse, and is refused if it is
            strict.
        quick: the graph is read quickly, so a first deploy reports topics that do not fit.
        notes: what the last look after the roll-out has read of ROS 2, as RosGraph has it.
    """

    cluster: Cluster
    release: ReleaseId
    reporter: Reporter
    cancel: threading.Event
    patience: float = PATIENCE
    expected: Mapping[str, Expected] = attrs.field(factory=dict)
    quick: bool = False
    notes: Mapping[str, Mapping[str, Any]] = attrs.field(factory=dict)
    last_good: int | None = None
    _first: bool = False
    _before: RosGraph | None = None
    _reading: Future[None] | None = None
    _removed: frozenset[str] = frozenset()
    _broken: list[Verdict] = attrs.field(factory=list)

    @property
    def span(self) -> float:
        """For how many seconds rates are measured."""
        from rigel_graph.expectations import choose_span

        return choose_span(self.expected)

    def begin(self, plan: Plan) -> None:
        """Read the graph, if the plan replaces pods of a release that was good."""
        if not any(map(changes_pods, plan.changes)):
            return
        last = find_last_good(self.cluster, self.release)
        if last is None:
            self._first = True
            return
        self.last_good = last.number
        if not uses_ros(plan):
            return
        from rigel_graph.reading import list_objects

        self.reporter.progress("ROS graph", "being read before the update")
        try:
            listed = list_objects(self.cluster, self.release)
        except RigelK8sError as error:
            self._warn("is not compared", error)
            return
        if all(map(works_on, plan.changes)):
            self._reading = ThreadPoolExecutor(1).submit(self._read, plan, listed)
        else:
            self._read(plan, listed)

    def _read(self, plan: Plan, listed: Listed) -> None:
        """Read the graph before the update."""
        try:
            self._before = read_graph(self.cluster, self.release, self.span, listed)
        except RigelK8sError as error:
            self._warn("is not compared", error)
            return
        self._removed = list_removed(plan, self._before)
        nodes, topics = len(self._before.nodes), len(self._before.topics)
        state = f"{plural(nodes, 'node')} and {plural(topics, 'topic')} before the update"
        self.reporter.progress("ROS graph", state, done=True)

    def report(self, *, insist: bool = False) -> None:
        """Report what has changed as lines, and what is worse as warnings.

        Args:
            insist: refuse a graph that is worse.

        Raises:
            GraphWorse: it is, and `insist` is set, or it breaks what is strict; see its details.
            Interrupted: `cancel` was set.
        """
        if self._first and self.quick:
            self.report_misfits()
        found = self.find_differences()
        if found is None:
            return
        state = "not worse than before" if found.changed else "as before the update"
        if found.worse:
            state = "compared with that before the update"
        self.reporter.progress("ROS graph", state, done=True)
        for line in limit(found.changed):
            self.reporter.line(f"  {line}")
        if found.worse and (insist or any(one.strict for one in self._broken)):
            where = f"{self.release.name} in {self.release.namespace}"
            raise GraphWorse(
                f"the ROS graph of {where} is worse than before the update",
                details=limit(found.worse),
            )
        for line in limit(found.worse):
            self.reporter.warn(line)

    def report_misfits(self) -> None:
        """Warn of topics that are subscribed to without a publisher, and of two types.

        Names that do not fit are the most common mistake of a first deploy. Nodes that are ready
        may need a moment for their topics.
        """
        from rigel_graph.problems import find_problems

        until = time.monotonic() + MOMENT
        while True:
            try:
                found = find_problems(read_graph(self.cluster, self.release, 0.0))
            except RigelK8sError:  # `rigel graph` reports why
                return
            misfits = tuple(problem.text for problem in found if problem.kind in MISFITS)
            if not misfits or time.monotonic() >= until or self.cancel.wait(AGAIN):
                break
        for line in limit(misfits):
            self.reporter.warn(line)

    def find_differences(self) -> Comparison | None:
        """Return the effect of the update on the graph; None if it was not, or cannot be, read.

        It is compared again until it is not worse, at most for the patience and one look. Of
        several rates of a topic the highest counts: one look is too short for slow topics.
        """
        if self._reading is not None:
            while wait([self._reading], timeout=SOON).not_done:
                self._pause("still being read before the update", 0.0)
            self._reading.result()
        if self._before is None:
            return None
        from rigel_graph.comparison import compare

        self.await_leaving()
        until = time.monotonic() + self.patience
        highest: dict[str, float] = {}
        while True:
            found: Comparison | RigelK8sError
            try:
                after = read_graph(self.cluster, self.release, self.span)
            except RigelK8sError as error:
                self.notes, found, state = {}, error, error.message
            else:
                self.notes, self._broken = after.notes, self.find_broken(after)
                after = keep_highest(after, highest)
                lines = group_lines(self._broken)
                found = compare(self._before, after, removed=self._removed, broken=lines)
                state = next(iter(found.worse), "")
            if not state or time.monotonic() >= until:
                break
            self._pause(f"{state}; {self.patience:.0f} s are given for that", AGAIN)
        if isinstance(found, RigelK8sError):
            self._warn("cannot be compared", found)
            return None
        return found

    def await_leaving(self) -> None:
        """Wait until the old pods have ended, at most for LEAVING: their nodes go with them."""
        from rigel_graph.pods import find_leaving

        until = time.monotonic() + LEAVING
        while time.monotonic() < until:
            try:
                leaving = find_leaving(list_pods(self.cluster, self.release))
            except RigelK8sError:  # reading the graph reports why
                return
            if not leaving:
                return
            state = f"{leaving[0]} is still in a pod that is being terminated"
            self._pause(f"{state}; {LEAVING:.0f} s are given for that", SOON)

    def _pause(self, state: str, seconds: float) -> None:
        self.reporter.progress("ROS graph", state)
        if self.cancel.wait(seconds):
            raise Interrupted(
                "stopped while comparing the ROS graph; what was applied stays on the cluster"
            )

    def find_broken(self, after: RosGraph) -> list[Verdict]:
        """Return what is not as expected now, and was before the update."""
        from rigel_graph.expectations import compare_with, list_broken

        assert self._before is not None
        return list_broken(*(compare_with(self.expected, one) for one in (self._before, after)))

    def _warn(self, what: str, error: RigelK8sError) -> None:
        self.reporter.progress("ROS graph", what, done=True)
        details = "".join(f"\n  {line}" for line in error.details)
        self.reporter.warn(f"the ROS graph {what}: {error.message}{details}")


def group_lines(broken: Iterable[Verdict]) -> dict[str, list[str]]:
    """Return the lines about each topic, each once."""
    lines: dict[str, list[str]] = {}
    for one in broken:
        known = lines.setdefault(one.topic, [])
        if one.line not in known:
            known.append(one.line)
    return lines


def limit(lines: tuple[str, ...]) -> tuple[str, ...]:
    """Return the first lines, and how many more there are."""
    if len(lines) <= MOST:
        return lines
    return (*lines[: MOST - 1], f"and {len(lines) - MOST + 1} more; `rigel graph` shows all")


def read_graph(
    cluster: Cluster, release: ReleaseId, span: float, listed: Listed | None = None
) -> RosGraph:
    """Return a release's graph; what reads it is imported here, see above."""
    from rigel_graph import reading

    return reading.read_graph(cluster, release, span=span, listed=listed)


def keep_highest(graph: RosGraph, highest: dict[str, float]) -> RosGraph:
    """Return a graph with the highest rates of all looks so far, which are kept in `highest`."""
    for topic in graph.topics:
        if topic.rate is not None:
            highest[topic.name] = max(topic.rate, highest.get(topic.name, 0.0))
    topics = [attrs.evolve(topic, rate=highest.get(topic.name)) for topic in graph.topics]
    return attrs.evolve(graph, topics=tuple(topics))


def changes_pods(step: Step) -> bool:
    """Whether a step that writes starts, ends or replaces pods."""
    if step.ref.kind not in WORKLOADS:
        return False
    if step.action != "change" or step.live is None or step.result is None:
        return True
    return bool(step.live.get("spec") != step.result.get("spec"))


def works_on(step: Step) -> bool:
    """Whether a step ends no node before another one, which waits first, takes over from it."""
    if not changes_pods(step) or step.action == "create":
        return True
    if step.result is None or step.replaces:
        return False
    if count_pods(step.result) < count_pods(step.live):
        return False
    containers = step.result["spec"]["template"]["spec"]["containers"]
    return any(env["name"] == HANDS_OVER for one in containers for env in one.get("env") or ())


def uses_ros(plan: Plan) -> bool:
    """Whether a workload that is on the cluster is of ROS; each is, unless its pods deny it."""
    return any(
        not denies_ros(one["spec"]["template"]["metadata"].get("annotations"))
        for step in plan.steps
        if step.ref.kind in WORKLOADS and step.live is not None
        for one in split(step.live)
    )


def list_removed(plan: Plan, before: RosGraph) -> frozenset[str]:
    """Return the names of nodes that a plan removes on purpose.

    These are the nodes of workloads that are deleted or get fewer pods, or that run once, and nodes
    whose name changes; but none that the release still expects, for example in another workload.
    """
    workloads: set[str] = set()
    names: set[str] = set()
    kept: set[str] = set()
    for step in plan.steps:
        if step.ref.kind == "Job":
            workloads.add(step.ref.name)
        if step.ref.kind not in WORKLOADS:
            continue
        then = step.result if step.result is not None else step.manifest
        fewer = step.action == "change" and count_pods(then) < count_pods(step.live)
        if step.action == "prune" or fewer:
            workloads.update(
                one["metadata"]["name"] for one in split(step.live or {"metadata": {}})
            )
        elif then is not None:
            kept.update(name_nodes(then))
        if step.action == "change" and step.live and then:
            names.update({*name_nodes(step.live)} - {*name_nodes(then)})
    return frozenset(
        node.name
        for node in before.nodes
        if (node.workload in workloads or node.name in names) and node.name not in kept
    )


def name_nodes(manifest: Manifest) -> list[str]:
    """Return the ROS names that a workload promises."""
    notes = (one["metadata"].get("annotations") or {} for one in split(manifest))
    return [str(one[ROS_NAME_ANNOTATION]) for one in notes if ROS_NAME_ANNOTATION in one]


def count_pods(manifest: Manifest | None) -> int:
    """Return how many pods a workload has."""
    found = ((manifest or {}).get("spec") or {}).get("replicas")
    return 1 if found is None else int(found)

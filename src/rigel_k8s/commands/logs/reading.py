"""logs: of some or all ROS nodes, by time, followed through restarts and roll-outs.

Lines come from the API server. Where the past is requested (`since`, `level`) they come from Loki
instead, if it is installed: it has the lines of deleted pods, but not those of the last seconds.
"""

from __future__ import annotations

import heapq
import queue
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import attrs

from rigel_k8s.commands.logs.lines import (
    DISORDER,
    SECOND,
    LevelReader,
    LogLine,
    LogOptions,
    at_least,
    sort_lines,
    split_stamp,
    stamp,
    time_of,
)
from rigel_k8s.commands.logs.stored import Asked, Stored, read_stored
from rigel_k8s.commands.pods import (
    Pod,
    find_matching,
    no_node_error,
    no_pod_error,
    pod_of,
    release_pods,
)
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.podnodes import split
from rigel_k8s.observability.names import LOKI
from rigel_k8s.observability.reading.stack import NoStack, choose_service, explain
from rigel_k8s.settings import Settings

HOUR = 3600  # seconds: how far `level` looks back by default
LOOK = 0.2  # seconds between two checks whether a follow has ended


def logs(
    settings: Settings, nodes: Sequence[str], options: LogOptions, job: str | None = None
) -> Iterator[LogLine]:
    """Yield log lines of the nodes (all, if none is named); `follow` ends when it is closed.

    Raises:
        UserError: the node is unknown, or there is no pod at all.
        ClusterError: the one requested pod has no log.
    """
    found = release(settings, job, nodes)
    with found.cluster:
        yield from read_lines(found, nodes, options)


def read_lines(
    found: Release,
    nodes: Sequence[str],
    options: LogOptions,
    cancel: threading.Event | None = None,
) -> Iterator[LogLine]:
    """Yield the lines of some nodes, by time; with `follow`, continue with new lines.

    Args:
        cancel: ends a follow.

    Raises: as logs.
    """
    if options.of_the_past and options.since is None:
        options = attrs.evolve(options, since=HOUR)
    stored = None
    if options.of_the_past and not options.follow:
        try:
            part = choose_service(found.cluster, LOKI, found.observability)
            stored = read_stored(part, found.id, options.since or HOUR)
        except NoStack:
            pass
        except ClusterError as error:
            text = f"{explain('Loki', error)}: these are only the lines of existing containers"
            yield LogLine("", "", text, note=True)
    everything = release_pods(found)
    asked = resolve_names(found, nodes, everything, stored)
    levels = at_least(options.level) if options.level else frozenset[str]()
    if stored is not None:
        yield from stored.lines(asked, levels, options.tail)
        return
    pods = [pod for pod in everything if asked.has(pod.workload, pod.name)]
    reader = PodReader(found, options, levels, pods)
    yield from reader.read()
    if options.follow:
        yield from reader.follow(asked.workloads, cancel or threading.Event())


def resolve_names(
    found: Release, nodes: Sequence[str], pods: Sequence[Pod], stored: Stored | None
) -> Asked:
    """Return whose lines some names mean: of existing pods, or of pods in Loki.

    Raises:
        UserError: a name is unknown, or there is no pod at all.
    """
    workloads: set[str] = set()
    names: set[str] = set()
    for node in nodes:
        if any(pod.name == node for pod in pods):
            names.add(node)
        elif there := find_matching(pods, node):
            workloads.update(pod.workload for pod in there)
        elif stored and (known := stored.resolve_name(node)):
            workloads |= known.workloads
            names |= known.pods
        else:
            raise no_node_error(found, node, pods)
    if not nodes:
        workloads = {pod.workload for pod in pods if not pod.helper}
        workloads |= stored.workloads if stored else frozenset()
        if not workloads:
            raise no_pod_error(found)
    return Asked(frozenset(workloads), frozenset(names))


class PodReader:
    """The lines of some pods from the API server: those that exist, and then those that come.

    A follow has a thread for each run of a container, and one that watches for new pods.

    Args:
        levels: only lines of these; empty: all.
        pods: those that exist; pods that come later are read from their beginning.
    """

    def __init__(
        self, found: Release, options: LogOptions, levels: frozenset[str], pods: Sequence[Pod]
    ) -> None:
        self._found = found
        self._options = options
        self._levels = levels
        self._begun = time.time_ns()
        self._pods = pods
        self._edges = {pod.key: Edge() for pod in pods}
        self._lines: queue.Queue[LogLine | Exception] = queue.Queue()

    def read(self) -> Iterator[LogLine]:
        """Yield the existing lines by time; of each pod the last ones, if only those are wanted."""
        lines = heapq.merge(*map(self._read_pod, self._pods), key=time_of)
        if self._options.tail is None:
            yield from lines
            return
        kept: dict[tuple[str, str], deque[LogLine]] = {}
        for line in lines:
            if line.note:
                yield line
            else:
                own = (line.pod, line.workload)
                kept.setdefault(own, deque(maxlen=self._options.tail)).append(line)
        yield from heapq.merge(*kept.values(), key=time_of)

    def _read_pod(self, pod: Pod) -> Iterator[LogLine]:
        """Yield a pod's lines, or the reason why they cannot be read."""
        try:
            yield from sort_lines(self._read_new(pod, follow=None))
        except ClusterError as error:
            if len(self._pods) == 1:
                raise
            yield LogLine(pod.workload, pod.name, error.message, note=True)

    def follow(self, workloads: Iterable[str], over: threading.Event) -> Iterator[LogLine]:
        """Yield new lines of the pods and of all pods of workloads, each once.

        Args:
            over: ends it; set when it is closed.
        """
        followed = {*workloads, *(pod.workload for pod in self._pods)}
        threading.Thread(target=self._watch, args=(followed, over), daemon=True).start()
        try:
            while not over.is_set():
                try:
                    line = self._lines.get(timeout=LOOK)
                except queue.Empty:
                    continue
                if isinstance(line, Exception):
                    raise line
                yield line
        finally:
            over.set()

    def _watch(self, workloads: set[str], over: threading.Event) -> None:
        """Follow each run of a container of the workloads in a thread."""
        own = {RELEASE_LABEL: self._found.id.name}
        space = self._found.id.namespace
        known: set[tuple[tuple[str, str], int]] = set()
        old = set(self._edges)
        try:
            while not over.is_set():
                for event in self._found.cluster.watch("v1", "Pod", space, labels=own, cancel=over):
                    for item in split(event.object):
                        pod, run = pod_of(item), run_of(item)
                        if event.type == "DELETED" or pod.workload not in workloads or run is None:
                            continue
                        if (pod.key, run) in known:
                            continue
                        known.add((pod.key, run))
                        if pod.key not in old:
                            self._edges[pod.key] = Edge(since=0)
                        old.discard(pod.key)
                        threading.Thread(target=self._follow, args=(pod, over), daemon=True).start()
        except Exception as error:
            self._lines.put(error)

    def _follow(self, pod: Pod, over: threading.Event) -> None:
        try:
            for line in self._read_new(pod, follow=over):
                self._lines.put(line)
        except RigelK8sError as error:
            if not over.is_set():
                self._lines.put(LogLine(pod.workload, pod.name, error.message, note=True))
        except Exception as error:
            self._lines.put(error)

    def _read_new(self, pod: Pod, *, follow: threading.Event | None) -> Iterator[LogLine]:
        """Yield a pod's lines of the requested levels that were not read before.

        Args:
            follow: continue until it is set.
        """
        edge = self._edges[pod.key]
        for text in self._found.cluster.logs(
            pod.namespace,
            pod.name,
            pod.container,
            follow=follow is not None,
            cancel=follow,
            timestamps=True,
            previous=self._options.previous,
            **self._choose_start(edge),
        ):
            moment, words = split_stamp(text)
            if moment is None:  # a message of the kubelet about the log
                yield LogLine(pod.workload, pod.name, text, note=True)
                continue
            if follow is None:
                edge.first = min(moment, edge.first or moment)
            elif moment < edge.first:  # `tail` left it out
                continue
            level = edge.reader.level(words)
            if edge.is_new(moment, words) and (not self._levels or level in self._levels):
                yield LogLine(
                    pod.workload,
                    pod.name,
                    words,
                    time=moment,
                    level=level,
                    ros_node=pod.ros_name,
                    node=pod.machine,
                )

    def _choose_start(self, edge: Edge) -> dict[str, Any]:
        """Return where the API server begins; of a level, the last lines are counted here."""
        if edge.since is not None:
            return {"since_time": f"{stamp(edge.since)[:19]}Z"} if edge.since else {}
        start: dict[str, Any] = {} if self._levels else {"tail": self._options.tail}
        if self._options.since is not None:
            passed = (time.time_ns() - self._begun) // SECOND
            start["since_seconds"] = self._options.since + passed
        return start


@attrs.define
class Edge:
    """Up to where a pod's lines were read.

    Attributes:
        since: the time to continue from, None if unknown, 0 for its beginning.
        first: the time of the earliest line that was read; 0 if there was none.
        known: the lines that were read from then on.
        reader: has the level that the next line may continue.
    """

    since: int | None = None
    first: int = 0
    known: set[tuple[int, str]] = attrs.field(factory=set)
    reader: LevelReader = attrs.field(factory=LevelReader)

    def is_new(self, moment: int, text: str) -> bool:
        """Return whether a line was not read before, and remember it."""
        if (moment, text) in self.known:
            return False
        self.known.add((moment, text))
        again = moment // SECOND * SECOND - DISORDER
        if self.since is None or again > self.since:
            self.since = again
            self.known = {line for line in self.known if line[0] >= again}
        return True


def run_of(item: dict[str, Any]) -> int | None:
    """Return how often the first container was restarted, None while it has not started."""
    statuses = item.get("status", {}).get("containerStatuses") or []
    name = item["spec"]["containers"][0]["name"]
    for status in statuses:
        if status["name"] == name and {"running", "terminated"} & set(status.get("state") or {}):
            return int(status.get("restartCount", 0))
    return None

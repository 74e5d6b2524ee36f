"""logs: of some or all ROS nodes, by time, followed through restarts and roll-outs.

Lines come from the API server. Where the past is requested (`since`, `level`) they come from Loki
instead, if it is installed: it has the lines of deleted pods, but not those of the last seconds.
"""

from __future__ import annotations

import heapq
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import attrs

from rigel_k8s.commands.logs.follow import Follow
from rigel_k8s.commands.logs.levels import LevelReader, at_least
from rigel_k8s.commands.logs.lines import (
    DISORDER,
    SECOND,
    LogLine,
    LogOptions,
    sort_lines,
    split_stamp,
    stamp,
    time_of,
)
from rigel_k8s.commands.logs.stored import Asked, Stored, read_stored
from rigel_k8s.commands.pods import Pod, find_matching, no_pod_error, pods_of, release_pods
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError
from rigel_k8s.observability.names import LOKI
from rigel_k8s.observability.reading.stack import NoStack, explain, part_of

HOUR = 3600  # seconds: how far `level` looks back by default


def history(
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
            part = part_of(found.cluster, LOKI, found.observability)
            stored = read_stored(part, found.id, options.since or HOUR)
        except NoStack:
            pass
        except ClusterError as error:
            text = f"{explain('Loki', error)}: these are only the lines of existing containers"
            yield LogLine("", "", text, note=True)
    past = Past(found, nodes, options, stored)
    yield from past.lines()
    if options.follow:
        yield from past.follow(cancel)


class Past:
    """The lines of some nodes' pods, and where to continue."""

    def __init__(
        self, found: Release, nodes: Sequence[str], options: LogOptions, stored: Stored | None
    ) -> None:
        self._found = found
        self._options = options
        self._levels = at_least(options.level) if options.level else frozenset[str]()
        self._stored = stored
        self._begun = time.time_ns()
        everything = release_pods(found)
        self._asked = resolve_names(found, nodes, everything, stored)
        self._pods = [pod for pod in everything if self._asked.has(pod.workload, pod.name)]
        self._edges = {pod.name: Edge() for pod in self._pods}

    def lines(self) -> Iterator[LogLine]:
        """Yield the existing lines."""
        if self._stored is not None:
            yield from self._stored.lines(self._asked, self._levels, self._options.tail)
        else:
            yield from self._tail(heapq.merge(*map(self._read, self._pods), key=time_of))

    def follow(self, cancel: threading.Event | None = None) -> Iterator[LogLine]:
        """Yield new lines, each once."""
        workloads = self._asked.workloads | {pod.workload for pod in self._pods}
        return Follow(self._found, workloads, self._pods, self._go_on, cancel).lines()

    def _read(self, pod: Pod) -> Iterator[LogLine]:
        """Yield a pod's lines, or the reason why they cannot be read."""
        try:
            yield from sort_lines(self._read_new(pod, follow=False))
        except ClusterError as error:
            if len(self._pods) == 1:
                raise
            yield LogLine(pod.workload, pod.name, error.message, note=True)

    def _tail(self, lines: Iterable[LogLine]) -> Iterator[LogLine]:
        """Yield the last lines of each pod, if only those are requested."""
        if self._options.tail is None:
            yield from lines
            return
        kept: dict[str, deque[LogLine]] = {}
        for line in lines:
            if line.note:
                yield line
            else:
                kept.setdefault(line.pod, deque(maxlen=self._options.tail)).append(line)
        yield from heapq.merge(*kept.values(), key=time_of)

    def _go_on(self, pod: Pod, *, old: bool, cancel: threading.Event) -> Iterator[LogLine]:
        if not old:
            self._edges[pod.name] = Edge(since=0)
        return self._read_new(pod, follow=True, cancel=cancel)

    def _read_new(
        self, pod: Pod, *, follow: bool, cancel: threading.Event | None = None
    ) -> Iterator[LogLine]:
        """Yield a pod's lines of the requested levels that were not read before."""
        edge = self._edges[pod.name]
        for text in self._found.cluster.logs(
            pod.namespace,
            pod.name,
            pod.container,
            follow=follow,
            cancel=cancel,
            timestamps=True,
            previous=self._options.previous,
            **self._choose_start(edge),
        ):
            moment, words = split_stamp(text)
            if moment is None:  # a message of the kubelet about the log
                yield LogLine(pod.workload, pod.name, text, note=True)
                continue
            if not follow:
                edge.first = min(moment, edge.first or moment)
            elif moment < edge.first:  # `tail` left it out
                continue
            level = edge.reader.level(words)
            if edge.is_new(moment, words) and (not self._levels or level in self._levels):
                yield line_of(pod, words, moment, level)

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


def resolve_names(
    found: Release, nodes: Sequence[str], pods: Sequence[Pod], stored: Stored | None
) -> Asked:
    """Return whose lines some names mean: of existing pods, or of pods in Loki.

    Raises:
        UserError: a name is unknown, or there is no pod at all.
    """
    if not nodes:
        there = {pod.workload for pod in pods if not pod.helper}
        known = stored.workloads if stored else frozenset[str]()
        if not (there | known):
            raise no_pod_error(found)
        return Asked(frozenset(there) | known)
    every = [resolve_name(found, node, pods, stored) for node in nodes]
    return Asked(
        frozenset().union(*(one.workloads for one in every)),
        frozenset().union(*(one.pods for one in every)),
    )


def resolve_name(found: Release, node: str, pods: Sequence[Pod], stored: Stored | None) -> Asked:
    """Return what one name means."""
    if any(pod.name == node for pod in pods):
        return Asked(frozenset(), frozenset({node}))
    if there := {pod.workload for pod in find_matching(pods, node)}:
        return Asked(frozenset(there))
    if stored and (known := stored.resolve_name(node)):
        return known
    pods_of(found, node)  # raises, and lists the existing nodes
    raise AssertionError("no pod matches, and one was found")


def line_of(pod: Pod, text: str, moment: int, level: str) -> LogLine:
    """Return a line of the API server."""
    return LogLine(
        pod.workload,
        pod.name,
        text,
        time=moment,
        level=level,
        ros_node=pod.ros_name,
        node=pod.machine,
    )

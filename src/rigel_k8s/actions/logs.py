"""logs: of some or all ROS nodes, followed through restarts and roll-outs.

What is asked of the past (`since`, `level`) is told in the order of time, from Loki where it is
there (actions/logs_history.py); what a pod says now comes as it is, from the API server alone.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import attrs

from rigel_k8s.actions.log_lines import LogLine
from rigel_k8s.actions.pods import Pod, chosen_pods, pod_of
from rigel_k8s.actions.targets import Release, release
from rigel_k8s.deploy.types import RELEASE_LABEL
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.kube import Cluster
from rigel_k8s.settings import Settings

__all__ = ["Follow", "LogLine", "LogOptions", "logs"]

LOOK = 0.2  # seconds between two looks whether a follow has ended


@attrs.frozen
class LogOptions:
    """Which log lines: of the last seconds, the last so many, of the container before.

    Attributes:
        level: this one of names.LEVELS and those above it.
        parsed: with time and level of each line, in the order of time.
    """

    follow: bool = False
    since: int | None = None
    tail: int | None = None
    previous: bool = False
    timestamps: bool = False
    level: str | None = None
    parsed: bool = False

    @property
    def of_the_past(self) -> bool:
        """Whether more is asked than the containers that there are now can tell."""
        return (self.since is not None or self.level is not None) and not self.previous


def logs(
    settings: Settings, nodes: Sequence[str], options: LogOptions, job: str | None = None
) -> Iterator[LogLine]:
    """Yield log lines of the nodes (all, where none is named); `follow` ends when it is closed.

    Raises:
        UserError: there is no such node, or no pod at all.
        ClusterError: the one pod that was asked for has no log.
    """
    found = release(settings, job)
    with found.cluster as cluster:
        if options.of_the_past or options.parsed or options.level:
            from rigel_k8s.actions.logs_history import history

            yield from history(found, nodes, options)
            return
        chosen = chosen_pods(found, nodes)
        if options.follow:

            def read(pod: Pod, *, old: bool, cancel: threading.Event) -> Iterator[LogLine]:
                # What began after us is new from its beginning.
                words = options if old else attrs.evolve(options, since=None, tail=None)
                return lines_of(cluster, pod, words, follow=True, cancel=cancel)

            yield from Follow(found, {pod.workload for pod in chosen}, chosen, read).lines()
            return
        for pod in chosen:
            try:
                yield from lines_of(cluster, pod, options)
            except ClusterError as error:
                if len(chosen) == 1:
                    raise
                yield LogLine(pod.workload, pod.name, error.message, note=True)


def lines_of(cluster: Cluster, pod: Pod, options: LogOptions, **more: Any) -> Iterator[LogLine]:
    """Yield one pod's log lines."""
    texts = cluster.logs(
        pod.namespace,
        pod.name,
        pod.container,
        since_seconds=options.since,
        tail=options.tail,
        previous=options.previous,
        timestamps=options.timestamps,
        **more,
    )
    return (LogLine(pod.workload, pod.name, text) for text in texts)


class Follow:
    """Lines of all pods of some workloads as they come: a thread for each run of a container.

    Args:
        pods: those that were there before; the others are read from their beginning.
        read: reads and follows a pod; `old` says that its pod was there before.
    """

    def __init__(
        self,
        found: Release,
        workloads: Collection[str],
        pods: Sequence[Pod],
        read: Callable[..., Iterator[LogLine]],
    ) -> None:
        self._cluster = found.cluster
        self._found = found
        self._workloads = workloads
        self._old = {pod.name for pod in pods}
        self._read = read
        self._lines: queue.Queue[LogLine | Exception] = queue.Queue()
        self._stop = threading.Event()
        self._seen: set[tuple[str, int]] = set()

    def lines(self) -> Iterator[LogLine]:
        """Yield lines until closed."""
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            while True:
                try:
                    line = self._lines.get(timeout=LOOK)
                except queue.Empty:
                    continue
                if isinstance(line, Exception):
                    raise line
                yield line
        finally:
            self._stop.set()

    def _watch(self) -> None:
        own = {RELEASE_LABEL: self._found.id.name}
        space = self._found.id.namespace
        try:
            while not self._stop.is_set():
                for event in self._cluster.watch("v1", "Pod", space, labels=own, cancel=self._stop):
                    if event.type != "DELETED":
                        self._look(event.object)
        except Exception as error:
            self._lines.put(error)

    def _look(self, item: dict[str, Any]) -> None:
        """Follow a container's run that is new."""
        pod, number = pod_of(item), run_of(item)
        if pod.workload not in self._workloads or number is None:
            return
        if (pod.name, number) in self._seen:
            return
        self._seen.add((pod.name, number))
        old = pod.name in self._old
        self._old.discard(pod.name)
        threading.Thread(target=self._follow, args=(pod,), kwargs={"old": old}, daemon=True).start()

    def _follow(self, pod: Pod, *, old: bool) -> None:
        try:
            for line in self._read(pod, old=old, cancel=self._stop):
                self._lines.put(line)
        except RigelK8sError as error:
            if not self._stop.is_set():
                self._lines.put(LogLine(pod.workload, pod.name, error.message, note=True))
        except Exception as error:
            self._lines.put(error)


def run_of(item: dict[str, Any]) -> int | None:
    """Return how often the first container was restarted, None while it has not started."""
    statuses = item.get("status", {}).get("containerStatuses") or []
    name = item["spec"]["containers"][0]["name"]
    for status in statuses:
        if status["name"] == name and {"running", "terminated"} & set(status.get("state") or {}):
            return int(status.get("restartCount", 0))
    return None

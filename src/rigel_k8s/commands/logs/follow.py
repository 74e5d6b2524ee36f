"""Log lines of some workloads as they come, through restarts and roll-outs."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

from rigel_k8s.commands.logs.lines import LogLine
from rigel_k8s.commands.pods import Pod, pod_of
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.objects.marks import RELEASE_LABEL

LOOK = 0.2  # seconds between two checks whether a follow has ended


class Follow:
    """Lines of all pods of some workloads as they come: a thread for each run of a container.

    Args:
        pods: those that existed before; other pods are read from their beginning.
        read: reads and follows a pod; `old`: the pod existed before.
        cancel: ends it, within LOOK.
    """

    def __init__(
        self,
        found: Release,
        workloads: Collection[str],
        pods: Sequence[Pod],
        read: Callable[..., Iterator[LogLine]],
        cancel: threading.Event | None = None,
    ) -> None:
        self._cluster = found.cluster
        self._found = found
        self._workloads = workloads
        self._old = {pod.name for pod in pods}
        self._read = read
        self._lines: queue.Queue[LogLine | Exception] = queue.Queue()
        self._stop = cancel or threading.Event()
        self._seen: set[tuple[str, int]] = set()

    def lines(self) -> Iterator[LogLine]:
        """Yield lines until closed or cancelled."""
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            while not self._stop.is_set():
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
        """Follow a new run of a container."""
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

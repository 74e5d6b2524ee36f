"""A release's lines in Loki: by the labels of the contract (observability/names.py)."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping, Sequence

import attrs

from rigel_k8s.commands.logs.lines import SECOND, LogLine, time_of
from rigel_k8s.objects.naming import object_name
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.observability.reading.loki import Entry, LokiClient, selector
from rigel_k8s.observability.reading.stack import StackService
from rigel_k8s.release.types import ReleaseId

AHEAD = 60 * SECOND  # machines' clocks may be ahead of ours


@attrs.frozen
class Asked:
    """Whose lines are requested: of all pods of some workloads, and of some pods."""

    workloads: frozenset[str]
    pods: frozenset[str] = frozenset()

    def has(self, workload: str, pod: str) -> bool:
        """Return whether a pod's lines are requested."""
        return workload in self.workloads or pod in self.pods


def read_stored(part: StackService, release: ReleaseId, since: int) -> Stored:
    """Return what Loki has of a release of the last `since` seconds; raises as StackService.ask."""
    loki = LokiClient(part.ask)
    now = time.time_ns()
    begin, end = now - since * SECOND, now + AHEAD
    own = {"application": release.name, "namespace": release.namespace}
    return Stored(loki, own, begin, end, loki.series(selector(**own), begin, end))


@attrs.frozen
class Stored:
    """A release's streams between two times."""

    _loki: LokiClient
    _own: Mapping[str, str]
    _begin: int
    _end: int
    _series: Sequence[Mapping[str, str]]

    @property
    def workloads(self) -> frozenset[str]:
        """The workloads with any line; the exporter is not a ROS node."""
        return frozenset({s.get("workload", "") for s in self._series} - {"", EXPORTER})

    def resolve_name(self, node: str) -> Asked | None:
        """Return what a name means: a pod's, a ROS name, or a Kubernetes name; None: nothing."""
        if any(labels.get("pod") == node for labels in self._series):
            return Asked(frozenset(), frozenset({node}))
        means = {f"/{node.lstrip('/')}", object_name(node)}
        found = {
            labels["workload"]
            for labels in self._series
            if means & {labels.get("ros_node"), labels.get("workload")} and "workload" in labels
        }
        return Asked(frozenset(found)) if found else None

    def lines(self, asked: Asked, levels: Collection[str], tail: int | None) -> Iterator[LogLine]:
        """Yield lines by time.

        Args:
            levels: only these; empty: all.
            tail: only this many last lines of each pod.
        """
        pods = {
            s["pod"] for s in self._series if asked.has(s.get("workload", ""), s.get("pod", ""))
        }
        if tail is not None:
            last = [line for pod in sorted(pods) for line in self._read_last(pod, levels, tail)]
            yield from sorted(last, key=time_of)
        elif pods:
            narrowed = {"pod": pods} if asked.pods else {"workload": asked.workloads}
            query = selector(**self._own, **narrowed, level=levels)
            for entry in self._loki.entries(query, self._begin, self._end):
                yield from lines_of(entry)

    def _read_last(self, pod: str, levels: Collection[str], tail: int) -> list[LogLine]:
        if not tail:
            return []
        query = selector(**self._own, pod=pod, level=levels)
        entries = self._loki.read_last(query, self._begin, self._end, tail)
        return [line for entry in entries for line in lines_of(entry)][-tail:]


def lines_of(entry: Entry) -> Iterator[LogLine]:
    labels = entry.labels
    for text in entry.text.split("\n"):
        yield LogLine(
            labels.get("workload", ""),
            labels.get("pod", ""),
            text,
            time=entry.time,
            level=labels.get("level", ""),
            ros_node=labels.get("ros_node", ""),
            node=labels.get("node", ""),
        )

"""Containers without probes, which are ready because they run: do they still?

A log shows an end sooner than the pod does. So it is followed from the moment that the pod is ready,
while Kubernetes waits for `minReadySeconds`: when that is over, little is left to wait for.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

import attrs

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.ending import LogEnd
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.objects.steady import find_unprobed

KINDS = ("Deployment", "DaemonSet", "StatefulSet")
FOLLOWED = 1.5  # seconds after a pod was ready for which its logs must have gone on
LEAST = 0.5  # of these, seconds that a log has to end: it took 0.03 s on an overloaded machine
LONG = 30.0  # seconds after which a log is left alone while others are waited for: it may be large
WIDTH = 32  # logs at the same time


@attrs.frozen
class Unprobed:
    """A container of a workload's pod that is ready because it runs."""

    workload: ObjectRef
    pod: str
    container: str
    uid: str  # of the pod


def find_unprobed_in(
    workload: ObjectRef, pods: Iterable[Manifest], away: Collection[str] = ()
) -> Iterator[Unprobed]:
    """Yield the containers without probes in those of a workload's ready pods that will stay.

    Args:
        away: machines whose pods are left out.
    """
    for pod in pods:
        meta, spec = pod["metadata"], pod["spec"]
        leaves = meta.get("deletionTimestamp") or spec.get("nodeName") in away
        if workload.kind in KINDS and is_ready(pod) and not leaves:
            for name in find_unprobed(spec):
                yield Unprobed(workload, meta["name"], name, meta["uid"])


@attrs.define
class LogWatch:
    """Follows the logs of containers without probes, some at a time; a context that ends it.

    Attributes:
        since: when each container was first seen to be ready.
        logs: those that are followed now.
        checked: those of which it is known that they ran at the end, or that they have ended.
    """

    cluster: Cluster
    since: dict[Unprobed, float] = attrs.field(factory=dict)
    logs: dict[Unprobed, LogEnd] = attrs.field(factory=dict)
    checked: set[Unprobed] = attrs.field(factory=set)

    def __enter__(self) -> LogWatch:
        return self

    def __exit__(self, *_: object) -> None:
        for log in self.logs.values():
            log.abort()

    def look(self, ready: Collection[Unprobed], now: float, *, last: bool) -> set[ObjectRef]:
        """Return the workloads of which a container was found to have ended, each container once.

        Args:
            ready: all that is ready now.
            last: all else is; what runs now is not looked at again.
        """
        ended = set()
        for one in self.logs.keys() - set(ready):  # its pod shows why
            self.logs.pop(one).abort()
        for one in ready:
            since = self.since.setdefault(one, now)
            log, late = self.logs.get(one), now - since >= LONG
            if log is None:
                if one not in self.checked and len(self.logs) < WIDTH and (last or not late):
                    seconds = max(LEAST, FOLLOWED - (now - since))
                    self.logs[one] = self.cluster.follow_end(
                        one.workload.namespace, one.pod, one.container, seconds=seconds
                    )
            elif log.settled and (last or late or log.ended):
                if log.ended:
                    ended.add(one.workload)
                if log.ended or last:
                    self.checked.add(one)
                self.logs.pop(one).abort()
        return ended

    def is_sure_of(self, ready: Iterable[Unprobed]) -> bool:
        """Whether all of these were checked."""
        return self.checked.issuperset(ready)

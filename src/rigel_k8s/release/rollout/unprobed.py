"""Containers without probes, which are ready because they run: do they still?

A log shows an end sooner than the pod does. So it is followed from the moment that the pod is
ready, while Kubernetes waits for `minReadySeconds`: when that is over, little is left to wait for.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

import attrs

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.ending import LogEnd
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.steady import find_unprobed

KINDS = ("Deployment", "DaemonSet", "StatefulSet")
LEAST = 0.5  # seconds that a log has to end: it took 0.03 s on an overloaded machine
LONG = 30.0  # seconds after which a log is left alone while others are waited for: it may be large
WIDTH = 32  # logs at the same time


@attrs.frozen
class Unprobed:
    """A container of a workload's pod that is ready because it runs.

    Attributes:
        uid: of the pod.
        seconds: how long it must have been ready.
    """

    workload: ObjectRef
    pod: str
    container: str
    uid: str
    seconds: float


def find_unprobed_in(
    workload: Manifest, pods: Iterable[Manifest], away: Collection[str] = ()
) -> Iterator[Unprobed]:
    """Yield the containers without probes in those of a workload's ready pods that will stay.

    Args:
        away: machines whose pods are left out.
    """
    ref = ref_of(workload)
    # Of `minReadySeconds` Kubernetes waits for one less, since it stores whole seconds.
    seconds = LEAST + max(0, int(workload["spec"].get("minReadySeconds") or 0) - 1)
    for pod in pods:
        meta, spec = pod["metadata"], pod["spec"]
        leaves = meta.get("deletionTimestamp") or spec.get("nodeName") in away
        if ref.kind in KINDS and is_ready(pod) and not leaves:
            for name in find_unprobed(spec):
                yield Unprobed(ref, meta["name"], name, meta["uid"], seconds)


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
            log, ready_for = self.logs.get(one), now - since
            late = ready_for >= LONG
            if log is None:
                if one not in self.checked and len(self.logs) < WIDTH and (last or not late):
                    self.logs[one] = self.cluster.follow_end(
                        one.workload.namespace, one.pod, one.container, seconds=LEAST
                    )
            elif log.ended or (log.settled and (late or (last and ready_for >= one.seconds))):
                if log.ended:
                    ended.add(one.workload)
                if log.ended or last:
                    self.checked.add(one)
                self.logs.pop(one).abort()
        return ended

    def is_sure_of(self, ready: Iterable[Unprobed]) -> bool:
        """Whether all of these were checked."""
        return self.checked.issuperset(ready)

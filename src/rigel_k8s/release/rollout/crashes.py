"""Which workloads have crashed: those without probes look ready in between.

The kubelet checks its containers once a second and then reports them, so one that has crashed is
Running and Ready for a second and, on a busy machine, longer. A workload counts as ready when no
container of it has ended for a while. One without probes is also looked at in the stream of its
log: the container runtime ends that with the container.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import TYPE_CHECKING

import attrs

from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.objects.steady import find_unprobed
from rigel_k8s.release.rollout.causes import containers

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

STEADY = 12.0  # seconds that a workload must stay up after its last crash to count as ready
KINDS = ("Deployment", "DaemonSet", "StatefulSet")
LOOK = 0.5  # seconds that a stream has to end: it took 0.03 s on an overloaded machine
WIDTH = 32  # checks at the same time: each does nothing but wait


@attrs.define
class CrashLog:
    """How often the containers of each pod have ended, and when a workload's last one did."""

    counts: dict[str, int] = attrs.field(factory=dict)
    changed: dict[ObjectRef, float] = attrs.field(factory=dict)

    def note(self, ref: ObjectRef, pods: Iterable[Manifest], now: float) -> None:
        """Note the newest pods of a workload; what ends while it is being deleted is no crash."""
        for meta, count in ((pod["metadata"], count_crashes(pod)) for pod in pods):
            if count > self.counts.get(meta["uid"], 0) and not meta.get("deletionTimestamp"):
                self.counts[meta["uid"]] = count
                self.changed[ref] = now

    def note_end(self, ref: ObjectRef, now: float) -> None:
        """Note that a container has stopped, which its pod does not show yet."""
        self.changed[ref] = now

    def find_unsteady(self, now: float) -> set[ObjectRef]:
        """Return the workloads whose last crash is not long ago."""
        return {ref for ref, since in self.changed.items() if now - since < STEADY}


def count_crashes(pod: Manifest) -> int:
    """Return how often the containers of a pod have ended."""
    states = containers(pod.get("status") or {})
    ended = sum(1 for c in states if (c.get("state") or {}).get("terminated", {}).get("exitCode"))
    return ended + sum(int(c.get("restartCount", 0)) for c in states)


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
    """Yield the containers without probes in those of a workload's pods that will stay.

    Args:
        away: machines whose pods are left out.
    """
    for pod in pods:
        meta, spec = pod["metadata"], pod["spec"]
        leaves = meta.get("deletionTimestamp") or spec.get("nodeName") in away
        if workload.kind in KINDS and not leaves:
            for name in find_unprobed(spec):
                yield Unprobed(workload, meta["name"], name, meta["uid"])


def find_ended(cluster: Cluster, suspects: Iterable[Unprobed]) -> set[ObjectRef]:
    """Return the workloads with a container that does not run, checking all of them at once.

    If logs may not be read, none counts as ended.
    """

    def look(one: Unprobed) -> bool:
        return cluster.runs(one.workload.namespace, one.pod, one.container, seconds=LOOK)

    known = list(suspects)
    alive = cluster.parallel(look, known, width=WIDTH)
    return {one.workload for one, runs in zip(known, alive, strict=True) if not runs}

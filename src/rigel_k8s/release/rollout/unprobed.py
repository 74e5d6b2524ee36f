"""Containers without probes: which they are, and whether they run at this moment.

The kubelet checks its containers once a second and then reports them, so one that has crashed is
Running and Ready for a second and, on a busy machine, longer. The stream of its log does not wait
for that: the container runtime ends it with the container.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import attrs

from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.objects.steady import find_unprobed

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

KINDS = ("Deployment", "DaemonSet", "StatefulSet")
LOOK = 0.5  # seconds that a stream has to end: it took 0.03 s on an overloaded machine
WIDTH = 32  # checks at the same time: each does nothing but wait


@attrs.frozen
class Unprobed:
    """A container of a workload's pod that is ready because it runs."""

    workload: ObjectRef
    pod: str
    container: str
    uid: str  # of the pod


def find_unprobed_in(workload: ObjectRef, pods: Iterable[Manifest]) -> Iterator[Unprobed]:
    """Yield the containers without probes in those of a workload's pods that will stay."""
    for pod in pods:
        meta = pod["metadata"]
        if workload.kind in KINDS and not meta.get("deletionTimestamp"):
            for name in find_unprobed(pod["spec"]):
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

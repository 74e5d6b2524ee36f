"""What belongs to the workloads of a release: ReplicaSets, pods, warnings; pure.

All of it is indexed once for each look: a thousand workloads must not search all pods each.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence

import attrs

from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.rollout.causes import choose_events, index_events, owner, pods_of


@attrs.frozen
class Surroundings:
    """What belongs to workloads, by the UID of its owner.

    Attributes:
        sets: ReplicaSets by their owner.
        pods: by their owner, and those without one under their own UID.
        events: warnings by their object.
    """

    sets: Mapping[str, Sequence[Manifest]]
    pods: Mapping[str, Sequence[Manifest]]
    events: Mapping[str, Sequence[Manifest]]

    def list_sets(self, workload: Manifest) -> Sequence[Manifest]:
        """Return a workload's ReplicaSets."""
        return self.sets.get(workload["metadata"]["uid"], ())

    def list_pods(self, workload: Manifest) -> list[Manifest]:
        """Return a workload's pods, old ones too."""
        owners = [workload, *self.list_sets(workload)]
        return [pod for one in owners for pod in self.pods.get(one["metadata"]["uid"], ())]

    def list_newest_pods(self, workload: Manifest) -> list[Manifest]:
        """Return the pods of a workload's newest template."""
        return pods_of(workload, self.list_sets(workload), self.list_pods(workload))

    def list_events(self, *objects: Manifest) -> list[Manifest]:
        """Return the warnings about some objects."""
        return choose_events(self.events, *objects)


def look_around(
    sets: Iterable[Manifest], pods: Iterable[Manifest], events: Iterable[Manifest] = ()
) -> Surroundings:
    """Return what a namespace has apart from workloads, indexed."""
    by_set, by_pod = defaultdict(list), defaultdict(list)
    for live in sets:
        by_set[owner(live)].append(live)
    for live in pods:
        by_pod[owner(live) or live["metadata"]["uid"]].append(live)
    return Surroundings(by_set, by_pod, index_events(events))

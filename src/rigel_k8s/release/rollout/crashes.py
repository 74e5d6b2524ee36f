"""Which workloads crashed lately: those without probes look ready in between.

Pure: the time is passed in.
"""

from __future__ import annotations

from collections.abc import Iterable

import attrs

from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.release.rollout.causes import containers

STEADY = 12.0  # seconds that a workload must stay up after its last crash to count as ready


@attrs.define
class CrashLog:
    """How often the containers of workloads have ended, and when that number last changed."""

    counts: dict[ObjectRef, int] = attrs.field(factory=dict)
    changed: dict[ObjectRef, float] = attrs.field(factory=dict)

    def note(self, ref: ObjectRef, pods: Iterable[Manifest], now: float) -> None:
        """Note the newest pods of a workload."""
        count = sum(map(count_crashes, pods))
        if count != self.counts.get(ref, 0):
            self.counts[ref] = count
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

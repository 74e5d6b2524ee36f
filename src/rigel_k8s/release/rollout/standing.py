"""How far the workloads of a release are, look after look; pure: objects and time are passed in."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import attrs

from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.marks import is_optional
from rigel_k8s.objects.refs import Manifest, ObjectRef
from rigel_k8s.release.rollout.causes import Cause, causes, containers, find_turn, list_restarts
from rigel_k8s.release.rollout.readiness import UNSEEN, ObjectReadiness, readiness_without
from rigel_k8s.release.rollout.unprobed import Unprobed, find_unprobed_in
from rigel_k8s.release.rollout.view import Related

STEADY = 12.0  # seconds that a workload must stay up again after a crash to count as ready


@attrs.define
class CrashLog:
    """How often the containers of each pod have ended, and when a workload was last seen so.

    Kubernetes starts one that ends soon again after 10 s, then 20 s: that it is down does not count
    as being steady.
    """

    counts: dict[str, int] = attrs.field(factory=dict)
    changed: dict[ObjectRef, float] = attrs.field(factory=dict)

    def note(self, ref: ObjectRef, pods: Iterable[Manifest], now: float) -> None:
        """Note the newest pods of a workload; what ends while it is being deleted is no crash."""
        for pod in pods:
            meta, count = pod["metadata"], count_crashes(pod)
            known = self.counts.get(meta["uid"], 0)
            if (count > known or is_down(pod)) and not meta.get("deletionTimestamp"):
                self.counts[meta["uid"]] = max(count, known)
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


def is_down(pod: Manifest) -> bool:
    """Return whether a container of a pod that has ended before waits to be started again."""
    states = containers(pod.get("status") or {})
    return any(c.get("restartCount") and "waiting" in (c.get("state") or {}) for c in states)


#: Kinds of causes for which a pod has failed for good.
LASTING = ("failed", "evicted")
GRACE = 30.0  # seconds that optional workloads have when all else is ready


@attrs.define
class Standing:
    """The workloads that are waited for, and what the last look has shown of them.

    Attributes:
        targets: as they were applied.
        away: the names of the machines whose pods are not waited for.
        live: as the last look has found them.
        related: what belongs to them.
        rolling: those that were not ready at some look: their containers are new.
        enough_since: when all but optional ones became ready, None if they are not.
    """

    targets: Mapping[ObjectRef, Manifest]
    away: frozenset[str] = frozenset()
    live: Mapping[ObjectRef, Manifest] = attrs.field(factory=dict)
    related: Related = attrs.field(factory=Related)
    states: dict[ObjectRef, ObjectReadiness] = attrs.field(factory=dict)
    rolling: set[ObjectRef] = attrs.field(factory=set)
    crashes: CrashLog = attrs.field(factory=CrashLog)
    unsteady: set[ObjectRef] = attrs.field(factory=set)
    enough_since: float | None = None

    def look(self, live: Mapping[ObjectRef, Manifest], related: Related, now: float) -> None:
        self.live, self.related = live, related
        for ref, there in live.items():
            newest = related.list_newest_pods(there)
            state = readiness_without(there, newest, related.list_pods(there), self.away)
            self.states[ref] = state
            # Until its controller has seen the change, the newest pods are the old ones.
            if ref in self.rolling and state.message != UNSEEN:
                self.crashes.note(ref, newest, now)
            if not state.done:
                self.rolling.add(ref)
        self.unsteady = self.crashes.find_unsteady(now)
        if self.list_late():
            self.enough_since = None
        elif self.enough_since is None:
            self.enough_since = now

    def is_ready(self, ref: ObjectRef) -> bool:
        """Whether a workload is ready and has not crashed lately."""
        state = self.states.get(ref)
        crashed = ref in self.unsteady and ref.kind != "Job"
        return state is not None and state.done and state.ok and not crashed

    def list_waiting(self) -> list[ObjectRef]:
        return [ref for ref in self.targets if not self.is_ready(ref)]

    def list_late(self) -> list[ObjectRef]:
        """Return what is not ready and is needed."""
        return [ref for ref in self.list_waiting() if not is_optional(self.targets[ref])]

    def list_unseen(self) -> list[ObjectRef]:
        """Return Deployments that have become ready and of which no new pod was seen."""
        return [
            ref
            for ref, live in self.live.items()
            if ref.kind == "Deployment" and ref in self.rolling and self.states[ref].ready
            if not self.related.list_newest_pods(live)
        ]

    def is_enough(self, now: float) -> bool:
        """Whether the wait is over: optional workloads only have a short while."""
        if self.enough_since is None:
            return False
        return now - self.enough_since >= GRACE or not self.list_waiting()

    def find_turn(self, ref: ObjectRef) -> str:
        """Return for what a workload's new pod waits before it takes over; "" if it does not."""
        live, related = self.live.get(ref), self.related
        if live is None or self.is_ready(ref):
            return ""
        pods = [pod for pod in related.list_newest_pods(live) if not is_ready(pod)]
        return next(filter(None, (find_turn(pod, related.list_events(pod)) for pod in pods)), "")

    def list_unprobed(self) -> list[Unprobed]:
        """Return the containers without probes in the new pods that are ready."""
        return [
            container
            for ref, live in self.live.items()
            if ref in self.rolling and self.states[ref].message != UNSEEN
            for container in find_unprobed_in(live, self.related.list_newest_pods(live), self.away)
        ]

    def find_causes(self) -> Iterator[tuple[ObjectRef, Cause]]:
        """Yield what is wrong now with what is not ready."""
        for ref in self.list_waiting():
            live, state = self.live.get(ref), self.states.get(ref)
            if live is None or state is None or state.message == UNSEEN:
                continue
            sets = self.related.list_sets(live)
            newest = self.related.list_newest_pods(live)
            events = self.related.list_events(live, *sets, *newest)
            found = causes(live, newest, events, sets)
            if state.done and not state.ok:
                found = [one for one in found if one.kind in LASTING]
                found = found or [Cause("failed", state.message)]
            elif ref.kind == "Job":  # which may try again
                found = [one for one in found if one.kind not in LASTING]
            if not found and ref in self.unsteady:  # the kubelet restarted it between two reports
                found = list(list_restarts(newest))
            yield from ((ref, cause) for cause in found)

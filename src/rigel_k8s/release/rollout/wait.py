"""Wait until what was applied is ready, or report why it will not be; it writes nothing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from typing import TypeAlias

import attrs

from rigel_k8s.errors import ClusterError, Interrupted, RolloutFailed
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.marks import RELEASE_LABEL, image_remedy_of, is_optional, remedy_of
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.order import WORKLOADS
from rigel_k8s.release.rollout.causes import Cause, causes, probe_failure
from rigel_k8s.release.rollout.claims import explain_claim
from rigel_k8s.release.rollout.crashes import CrashLog
from rigel_k8s.release.rollout.kinds import CAUSES
from rigel_k8s.release.rollout.patience import Ledger, Patience, Seen
from rigel_k8s.release.rollout.readiness import (
    UNSEEN,
    ObjectReadiness,
    readiness,
    readiness_without,
)
from rigel_k8s.release.rollout.surroundings import Surroundings
from rigel_k8s.release.rollout.unprobed import Unprobed, find_ended, find_unprobed_in
from rigel_k8s.release.rollout.view import EVENT, POD, REPLICA_SET, Kind, ReleaseView
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter

LOOK = 0.25  # seconds between two looks at the clock
BRIEF = 0.01  # seconds of a look after which the next one may follow at once
REST = 3  # pause, in durations of a look: a core is left for others
EXPLAIN = 0.5  # seconds between two searches for causes
QUIET = 2.0  # seconds without events: a quick roll-out needs none
SPARE = 600.0  # seconds that outages of the API server may prolong a wait
LOG_LINES = 12
LOGGED = ("crash", "restarted", "failed")  # causes of which the container's log says more
GRACE = 30.0  # seconds that optional objects have when all else is ready
Targets: TypeAlias = dict[ObjectRef, Manifest]
CauseKey: TypeAlias = tuple[ObjectRef, tuple[str, str]]
WAITED = (*WORKLOADS, "PersistentVolumeClaim", "CustomResourceDefinition")


def is_waited_for(manifest: Manifest) -> bool:
    """Whether an object takes time to become as its manifest describes it."""
    return manifest["kind"] in WAITED


@attrs.define
class Waiter:
    """One wait for the objects of a release.

    Attributes:
        way_out: what to do after a failure, as a sentence.
        still_ours: raises if the deploy must not continue (its Lease is lost).
        away: the names of the machines whose pods are not waited for.
        good: the revision before, which became ready; 0 for none.
        noted: the present causes as lines. They are part of the error if the roll-out fails, and
            are reported otherwise.
    """

    cluster: Cluster
    release: ReleaseId
    report: Reporter
    cancel: threading.Event
    timeout: float
    patience: Patience
    way_out: str
    still_ours: Callable[[], None]
    away: frozenset[str] = frozenset()
    good: int = 0
    ledger: Ledger = attrs.field(init=False)
    states: dict[ObjectRef, ObjectReadiness] = attrs.field(factory=dict)
    shown: dict[ObjectRef, tuple[str, bool]] = attrs.field(factory=dict)
    claims_that_wait: set[ObjectRef] = attrs.field(factory=set)
    rolling: set[ObjectRef] = attrs.field(factory=set)
    crashes: CrashLog = attrs.field(factory=CrashLog)
    unsteady: set[ObjectRef] = attrs.field(factory=set)
    looked_at: set[str] = attrs.field(factory=set)
    noted: dict[CauseKey, list[str]] = attrs.field(factory=dict)
    optional: dict[ObjectRef, str] = attrs.field(factory=dict)
    images: dict[ObjectRef, str] = attrs.field(factory=dict)
    enough_since: float | None = None
    explained: float = 0.0

    def __attrs_post_init__(self) -> None:
        self.ledger = Ledger(self.patience)

    def wait(self, applied: Sequence[Manifest]) -> None:
        """Return when all that was applied is ready.

        Raises:
            RolloutFailed: something will not become ready, or not within the time.
            Interrupted: `cancel` was set.
        """
        targets = {ref_of(live): live for live in applied if is_waited_for(live)}
        self.optional = {ref: remedy_of(live) for ref, live in targets.items() if is_optional(live)}
        self.images = {ref: image_remedy_of(live) for ref, live in targets.items()}
        if all(self.take_in(ref, readiness(live)) for ref, live in targets.items()):
            return
        # What is unreachable cannot become ready: that time does not count.
        deadline = time.monotonic() + self.timeout - self.cluster.sum_outages()
        spaces = {ref.namespace for ref in targets if ref.namespace}
        where = spaces.pop() if len(spaces) == 1 else ""
        with ReleaseView(self.cluster, where, self.timeout + SPARE) as view:
            self.watch(view, targets.values())
            try:
                self.follow(view, targets, deadline)
            except RolloutFailed:
                self.noted.clear()
                raise
            finally:
                self.report_noted(list(self.noted))

    def follow(self, view: ReleaseView, targets: Targets, deadline: float) -> None:
        """Look again and again until all is ready; raises as `wait`."""
        started = time.monotonic()
        while True:
            now = time.monotonic()
            if self.all_ready(view, targets) and self.all_run(view, targets):
                return
            self.still_ours()
            if now - started > QUIET:
                view.watch([EVENT], fields="type=Warning")
            self.look_for_causes(view, targets, now)
            if now > deadline + self.cluster.sum_outages() and self.enough_since is None:
                raise self.timeout_error(view, targets)
            if self.cancel.is_set():
                raise Interrupted(
                    f"interrupted while {self.release.name} was rolling out: "
                    "the cluster continues the roll-out",
                    hint=f"run the same command again to wait for it; {self.way_out}",
                )
            self.rest(time.monotonic() - now)
            view.refresh(LOOK)

    def rest(self, spent: float) -> None:
        """Let events gather after a look that took long: the next look handles all of them."""
        if spent > BRIEF:
            self.cancel.wait(min(LOOK, REST * spent))

    def watch(self, view: ReleaseView, targets: Iterable[Manifest]) -> None:
        """Watch the objects that we wait for, and their pods."""
        found = list(targets)
        kinds: set[Kind] = {(live["apiVersion"], live["kind"]) for live in found}
        own = f"{RELEASE_LABEL}={self.release.name}"
        view.watch(sorted(kinds - {POD}), labels=own)
        if kinds & {("apps/v1", "Deployment")}:
            view.watch([REPLICA_SET], labels=own if all(map(has_label, found)) else "")
        view.watch([POD], labels=own if all(map(has_label, found)) else "")

    def all_ready(self, view: ReleaseView, targets: Targets) -> bool:
        """Whether everything is ready; shows what has changed."""
        around = view.look_around()
        self.look_for_crashes(view, around, targets)
        for ref in targets:
            live = view.find(ref)
            if live is not None:
                self.take_in(ref, self.judge(around, live))
        return self.is_enough([ref for ref in targets if not self.is_ready(ref)])

    def is_enough(self, waiting: Sequence[ObjectRef]) -> bool:
        """Whether the wait is over: optional objects only have a short while."""
        if not all(ref in self.optional for ref in waiting):
            self.enough_since = None
            return False
        now = time.monotonic()
        self.enough_since = self.enough_since or now
        if waiting and now - self.enough_since < GRACE:
            return False
        for ref in waiting:
            keys = [key for key in self.noted if key[0] == ref]
            noted = [line for key in keys for line in self.noted.pop(key)]
            why, *rest = noted or [self.states[ref].message]
            text = f"{ref.name} is not ready: {why}; {self.release.name} runs without it"
            next_step = self.optional[ref] or "`rigel status` shows its state"
            self.report.warn("\n".join([f"{text}; {next_step}", *rest]))
            self.report.progress(ref.name, "", done=True)
        return True

    def look_for_crashes(self, view: ReleaseView, around: Surroundings, targets: Targets) -> None:
        """Note which workloads have crashed recently."""
        now = time.monotonic()
        for ref in targets:
            live = view.find(ref)
            if live is not None and ref.kind in WORKLOADS and ref in self.rolling:
                self.crashes.note(ref, around.list_newest_pods(live), now)
        self.unsteady = self.crashes.find_unsteady(now)

    def all_run(self, view: ReleaseView, targets: Targets) -> bool:
        """Whether containers without probes really run; each is checked once, when all is ready."""
        around, fresh = view.look_around(), list[Unprobed]()
        for ref in targets:
            live = view.find(ref)
            if live is not None and ref in self.rolling and self.is_ready(ref):
                own = around.list_newest_pods(live)
                here = [pod for pod in own if pod["spec"].get("nodeName") not in self.away]
                fresh += (u for u in find_unprobed_in(ref, here) if u.uid not in self.looked_at)
        self.looked_at |= {one.uid for one in fresh}
        over = find_ended(self.cluster, fresh)
        for ref in over:
            self.crashes.note_end(ref, time.monotonic())
        return not over

    def judge(self, around: Surroundings, live: Manifest) -> ObjectReadiness:
        """Return the state of an object."""
        if not self.away:
            return readiness(live)
        newest, pods = around.list_newest_pods(live), around.list_pods(live)
        return readiness_without(live, newest, pods, self.away)

    def take_in(self, ref: ObjectRef, state: ObjectReadiness) -> bool:
        """Note an object's state, show it, and return whether it is ready."""
        self.states[ref] = state
        if not state.done:
            self.rolling.add(ref)
        explained = ref in self.ledger.refs
        if ref.kind in WORKLOADS and not explained and state.message != UNSEEN:
            self.show(ref, state.message, done=self.is_ready(ref))
        return self.is_ready(ref)

    def is_ready(self, ref: ObjectRef) -> bool:
        """Whether an object is ready, or a claim that waits for its pod."""
        state = self.states.get(ref)
        if ref in self.unsteady and ref.kind != "Job":
            return False
        return ref in self.claims_that_wait or bool(state and state.done and state.ok)

    def show(self, ref: ObjectRef, text: str, *, done: bool) -> None:
        """Report the present state of a workload, once."""
        if self.shown.get(ref) != (text, done):
            self.shown[ref] = (text, done)
            self.report.progress(ref.name, text, done=done)

    def look_for_causes(self, view: ReleaseView, targets: Targets, now: float) -> None:
        """Show what is wrong when it is seen, and give up on what has lasted too long."""
        if now - self.explained < EXPLAIN:
            return
        self.explained = now
        found = list(self.find_causes(view, targets))
        wrong = {ref for ref, _ in found}
        coming = any(not self.is_ready(ref) and ref not in wrong for ref in targets)
        for seen in self.ledger.note(now, found, others_coming=coming, unsteady=self.unsteady):
            if seen.cause.kind != "restarted":
                self.noted[seen.ref, seen.cause.key] = [seen.cause.message, *self.log_of(seen)]
        self.report_noted([key for key in self.noted if key not in self.ledger.seen])
        for ref, cause in dict(reversed(found)).items():  # the first of each: two would alternate
            if ref.kind in WORKLOADS:
                self.show(ref, cause.message, done=False)
        if hopeless := [s for s in self.ledger.find_hopeless(now) if s.ref not in self.optional]:
            raise self.failure(hopeless)

    def find_causes(self, view: ReleaseView, targets: Targets) -> Iterator[tuple[ObjectRef, Cause]]:
        """Yield what is wrong now."""
        around = view.look_around(warnings=True)
        for ref in targets:
            live = view.find(ref)
            if live is None or self.is_ready(ref):
                continue
            if self.states[ref].done and not self.states[ref].ok:
                yield ref, Cause("failed", self.states[ref].message)
            elif ref.kind == "PersistentVolumeClaim":
                yield from ((ref, cause) for cause in self.look_at_claim(ref, live))
            elif ref.kind in WORKLOADS:
                sets, newest = around.list_sets(live), around.list_newest_pods(live)
                for cause in causes(live, newest, around.list_events(live, *sets, *newest), sets):
                    yield ref, cause

    def look_at_claim(self, ref: ObjectRef, live: Manifest) -> Iterator[Cause]:
        """Yield why a claim is not bound; note one that waits for its first pod."""
        with suppress(ClusterError):
            cause = explain_claim(self.cluster, live)
            if cause is None:
                self.claims_that_wait.add(ref)
            else:
                yield cause

    def report_noted(self, keys: Iterable[CauseKey]) -> None:
        """Report causes that have not made the roll-out fail."""
        for key in keys:
            message, *log = self.noted.pop(key)
            self.report.warn("\n".join([f"{key[0].name}: {message}", *log]))

    def log_of(self, seen: Seen) -> list[str]:
        """Return a crashed container's last lines."""
        cause = seen.cause
        if cause.kind not in LOGGED or not cause.pod:
            return []
        with suppress(ClusterError):
            lines = self.cluster.logs(
                seen.ref.namespace,
                cause.pod,
                cause.container or None,
                tail=LOG_LINES,
                previous=cause.previous,
            )
            return [f"    {line}" for line in lines]
        return []

    def failure(self, hopeless: Sequence[Seen]) -> RolloutFailed:
        """Return the error for causes that will not go away; nodes often share an image."""
        first, what = hopeless[0], hopeless[0].cause.message
        known = list(self.ledger.seen.values())
        others = [seen for seen in known if seen.cause.message != what]
        failed = list(dict.fromkeys(seen.ref for seen in (*hopeless, *known) if seen not in others))
        names = ", ".join(ref.name for ref in failed)
        return RolloutFailed(
            f"{self.name_survivor(failed)}{names} did not become ready: {what}",
            hint=self.hint(first.ref, first.cause.kind),
            details=[*self.log_of(first), *self.list_causes(others)],
        )

    def name_survivor(self, failed: Iterable[ObjectRef]) -> str:
        """Return the beginning of a failure: that the version before still does the work."""
        number = f" (revision {self.good})" if self.good else ""
        if all(ref in self.states and self.states[ref].old_runs for ref in failed):
            return f"the old version still runs{number}; "
        return ""

    def list_causes(self, seen: Iterable[Seen]) -> Iterator[str]:
        """Yield causes as lines, each once with the names of all that have it."""
        alike: dict[str, list[Seen]] = {}
        for one in seen:
            alike.setdefault(one.cause.message, []).append(one)
        for message, found in alike.items():
            yield f"{', '.join(one.ref.name for one in found)}: {message}"
            yield from self.log_of(found[0])

    def timeout_error(self, view: ReleaseView, targets: Targets) -> RolloutFailed:
        """Return the error for a roll-out that took too long."""
        around, lines, late = view.look_around(warnings=True), [], self.find_late(targets)
        for ref in late:
            live = view.find(ref)
            pods = around.list_newest_pods(live) if live else []
            failures = [probe_failure(pod, around.list_events(pod)) for pod in pods]
            state = self.states[ref].message if ref in self.states else "not seen"
            lines.append("; ".join([f"{ref.kind} {ref.name}: {state}", *filter(None, failures)]))
        lines += self.list_causes(self.ledger.seen.values())
        names = ", ".join(ref.name for ref in late)
        many = f"{len(late)} of {len(targets)} not ready within {self.timeout:g} s"
        return RolloutFailed(
            f"{self.name_survivor(late)}{many}: {names}",
            hint=self.hint(late[0]) if late else None,
            details=lines,
        )

    def find_late(self, targets: Targets) -> list[ObjectRef]:
        """Return the required objects that are not ready."""
        return [ref for ref in targets if not self.is_ready(ref) and ref not in self.optional]

    def hint(self, ref: ObjectRef, kind: str = "") -> str:
        """Return what to do next: about a kind of cause, if it is known."""
        logs = f"`rigel logs {ref.name}` shows its output"
        remedy = logs if kind in ("", *LOGGED) else CAUSES[kind].remedy
        if kind in (*LOGGED, "image", "image-name", "start") and self.images.get(ref):
            remedy = f"{self.images[ref]}; {remedy}"
        return f"{remedy}; {self.way_out}"


def has_label(live: Manifest) -> bool:
    """Whether an object's pods carry the release's label."""
    template = (live.get("spec") or {}).get("template")
    if template is None:
        return True
    return RELEASE_LABEL in ((template.get("metadata") or {}).get("labels") or {})

"""Carries out the steps of a plan; writing.py writes one object."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, ConflictError, Interrupted
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Conflict
from rigel_k8s.kube.store import ANYTHING, NOTHING, Onto, this_object, this_state
from rigel_k8s.objects.marks import FIRST_ANNOTATION
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.labelling import managers, take_over
from rigel_k8s.release.part import Run
from rigel_k8s.release.plan import predecessors
from rigel_k8s.release.survey import belongs, describe_namespace, describe_owner
from rigel_k8s.release.types import WORKLOADS, Plan, ReleaseId, Step, rank, wave

Live = dict[str, Any]
GONE_TIMEOUT = 120.0  # seconds that a deletion may take
DEFINED_TIMEOUT = 30.0
LOOK = 0.2
SLICE = 2.0  # seconds of one watch for the end of pods
DELETED = "is being deleted"
CLAIMS = frozenset({"PersistentVolumeClaim", "PersistentVolume"})


@attrs.frozen
class Applier:
    """Carries out a plan.

    Attributes:
        confirm: called before each write; raises if the release's Lease is lost.
        until_ready: waits for live objects; called between those that come first and the rest.
        state: the state after an interruption, as a sentence.
        way_out: what to do after one.
        ended: the deleted workloads that have no pod any more.
    """

    run: Run
    confirm: Callable[[], None] = lambda: None
    until_ready: Callable[[Sequence[Manifest]], None] = lambda _: None
    state: str = "interrupted while objects were being applied: some are new, some old"
    way_out: str = "run the same command again to complete it"
    ended: set[ObjectRef] = attrs.field(factory=set)

    @property
    def limit(self) -> float:
        """Seconds that deleted objects may take to end."""
        return self.run.options.timeout or GONE_TIMEOUT

    def apply(self, plan: Plan) -> dict[ObjectRef, Live]:
        """Create and change what the plan contains; return the live objects, also the kept ones."""
        steps = [step for step in plan.steps if step.manifest is not None]
        applied = {s.ref: dict(s.live) for s in steps if s.action == "keep" and s.live}
        self.end(predecessors(plan))
        writes = [step for step in steps if step.action in ("create", "change")]
        ordered = groups(writes)
        for chosen in ordered:
            self.go_on()
            done = self.run.cluster.parallel(self.write, chosen)
            applied |= {s.ref: live for s, live in zip(chosen, done, strict=True)}
            self.wait_until_defined(chosen)
            if comes_first(chosen[0]) and chosen is not ordered[-1]:
                self.until_ready(done)
        return applied

    def write(self, step: Step) -> Live:
        """Apply one manifest."""
        if step.manifest is None:
            raise AssertionError("only steps with a manifest write")
        live = step.live
        if step.replaces:
            self.end([step])
        if live is not None and (step.replaces or live["metadata"].get("deletionTimestamp")):
            self.wait_until_gone([step.ref])
            live = None
        self.confirm_lease()
        if live is not None and keeps_rolling(step.manifest, live):
            live = self.end_rolling(live)
        return write(self.run, step.manifest, live)

    def end_rolling(self, live: Manifest) -> Live:
        """Make a rolling Deployment a Recreate one; its pods stay as they are.

        Server-side apply cannot: what Kubernetes had filled in of the old strategy would stay, and
        Kubernetes refuses it together with the new one.
        """
        spec = {"strategy": {"type": "Recreate", "rollingUpdate": None}}
        body = {"metadata": {"uid": live["metadata"]["uid"]}, "spec": spec}
        return self.run.cluster.patch(ref_of(live), body)

    def prune(self, steps: Iterable[Step]) -> None:
        """Delete what the plan prunes: workloads first, then what they used, data last.

        Workloads that were applied first are deleted last: ROS nodes unregister at their master,
        and hang if nothing answers any more.
        """
        todo = [step for step in steps if step.action == "prune"]
        workloads = [step for step in todo if step.ref.kind in WORKLOADS]
        others = [step for step in todo if step.ref.kind not in WORKLOADS]
        last = [step for step in workloads if comes_first(step)]
        before = [step for step in workloads if step not in last]
        self.run.cluster.parallel(self.delete, before)
        if last or any(step.ref.kind in CLAIMS for step in others):
            self.wait_until_no_pods(before)
        self.run.cluster.parallel(self.delete, last)
        if any(step.ref.kind in CLAIMS for step in others):
            self.wait_until_no_pods(last)
        for number in sorted({rank(step.ref.kind) for step in others}, reverse=True):
            alike = [step for step in others if rank(step.ref.kind) == number]
            self.run.cluster.parallel(self.delete, alike)

    def remove(self, plan: Plan) -> None:
        """Delete all that a plan prunes, and wait until no pod and none of its data is left."""
        self.prune(plan.steps)
        pruned = [step for step in plan.steps if step.action == "prune"]
        self.wait_until_no_pods(pruned)
        # A deploy right after this must not meet the old data.
        self.wait_until_gone([step.ref for step in pruned if step.ref.kind in CLAIMS])

    def end(self, steps: Sequence[Step]) -> None:
        """Delete objects and wait for the end of their pods."""
        self.run.cluster.parallel(self.delete, steps)
        self.wait_until_no_pods(steps, "ends before its successor starts")

    def delete(self, step: Step) -> None:
        """Delete the very object that the plan saw."""
        uid = step.live["metadata"]["uid"] if step.live else None
        self.confirm_lease()
        try:
            self.run.cluster.delete(step.ref, uid=uid)
        except ConflictError:
            self.run.report.warn(
                f"{step.ref} was replaced by another program meanwhile: left alone"
            )

    def confirm_lease(self) -> None:
        """Raise if another process may change the release by now."""
        try:
            self.confirm()
        except ClusterError:
            self.go_on()  # the user may have ended a wait for the API server
            raise

    def wait_until_no_pods(self, steps: Iterable[Step], state: str = DELETED) -> None:
        """Wait until no pod of some workloads is left; show which one is waited for."""
        ending = [step for step in steps if step.ref not in self.ended]
        self.wait_until_gone([step.ref for step in ending if step.ref.kind == "Pod"])
        for step in ending:
            if labels := selector(step.live):
                self.run.report.progress(step.ref.name, state)
                self.wait_until_no_pods_of(step.ref, labels)
                self.run.report.progress(step.ref.name, "deleted", done=True)
                self.ended.add(step.ref)

    def wait_until_no_pods_of(self, ref: ObjectRef, labels: Mapping[str, str]) -> None:
        end = time.monotonic() + self.limit
        while time.monotonic() < end:
            self.go_on()
            found = self.run.cluster.list(
                "v1", "Pod", ref.namespace, labels=labels, metadata_only=True
            )
            left = {pod["metadata"]["name"] for pod in found}
            if not left:
                return
            self.drain(ref, labels, left)
        raise ClusterError(
            f"pods of {ref} did not end within {self.limit:g} s: {', '.join(sorted(left))}",
            hint="check whether their machine is reachable:"
            f" kubectl -n {ref.namespace} get pods -o wide",
        )

    def drain(self, ref: ObjectRef, labels: Mapping[str, str], left: set[str]) -> None:
        """Watch pods for a while, or until none is left."""
        for event in self.run.cluster.watch(
            "v1", "Pod", ref.namespace, labels=labels, seconds=SLICE, cancel=self.run.options.cancel
        ):
            name = event.object["metadata"]["name"]
            if event.type == "DELETED":
                left.discard(name)
                if not left:
                    return
            else:
                left.add(name)

    def wait_until_gone(self, refs: Sequence[ObjectRef]) -> None:
        """Wait until objects that are being deleted no longer exist, for all of them at once."""
        end, left = time.monotonic() + self.limit, self.find_ending(refs)
        for live in left:
            self.run.report.progress(ref_of(live).name, DELETED)
        while left:
            if time.monotonic() > end:
                raise ClusterError(
                    f"{len(left)} object(s) still exist after {self.limit:g} s",
                    hint="something still uses them; see kubectl describe",
                    details=[f"{ref_of(live)}: {name_holders(live)} holds it" for live in left],
                )
            self.go_on()
            self.run.options.cancel.wait(LOOK)
            before, left = left, self.find_ending([ref_of(live) for live in left])
            for ref in set(map(ref_of, before)) - set(map(ref_of, left)):
                self.run.report.progress(ref.name, "deleted", done=True)

    def find_ending(self, refs: Sequence[ObjectRef]) -> list[Live]:
        """Return the objects that exist and are being deleted."""
        found = filter(None, self.run.cluster.parallel(self.run.cluster.get, refs))
        return [live for live in found if live["metadata"].get("deletionTimestamp")]

    def wait_until_defined(self, steps: Iterable[Step]) -> None:
        """Wait until the kinds that were just defined are served."""
        end = time.monotonic() + DEFINED_TIMEOUT
        for step in steps:
            for api_version, kind in list_defined_kinds(step.manifest):
                while not self.run.cluster.serves(api_version, kind):
                    if time.monotonic() > end:
                        raise ClusterError(f"{step.ref} is not served after {DEFINED_TIMEOUT:g} s")
                    self.go_on()
                    self.run.options.cancel.wait(LOOK)

    def go_on(self) -> None:
        """Raise Interrupted if the user asked to stop."""
        if self.run.options.cancel.is_set():
            raise Interrupted(self.state, hint=self.way_out)


def name_holders(live: Manifest) -> str:
    """Return what keeps an object that is being deleted."""
    return ", ".join(live["metadata"].get("finalizers") or []) or "something unknown"


def selector(live: Manifest | None) -> Mapping[str, str]:
    """Return the labels that a workload selects its pods by."""
    spec = (live or {}).get("spec") or {}
    labels: Mapping[str, str] = (spec.get("selector") or {}).get("matchLabels") or {}
    return labels


def list_defined_kinds(manifest: Manifest | None) -> list[tuple[str, str]]:
    """Return the API versions and kinds that a CustomResourceDefinition brings."""
    if manifest is None or manifest["kind"] != "CustomResourceDefinition":
        return []
    spec = manifest["spec"]
    served = [version["name"] for version in spec["versions"] if version.get("served")]
    return [(f"{spec['group']}/{version}", spec["names"]["kind"]) for version in served]


def comes_first(step: Step) -> bool:
    """Whether the other workloads of the release start only when this one is ready."""
    meta = (step.manifest or step.live or {}).get("metadata", {})
    return bool((meta.get("annotations") or {}).get(FIRST_ANNOTATION) == "true")


def keeps_rolling(manifest: Manifest, live: Manifest) -> bool:
    """Whether a live Deployment has parts of a strategy that a manifest no longer has."""
    if manifest["kind"] != "Deployment":
        return False
    wanted, there = (item.get("spec", {}).get("strategy") or {} for item in (manifest, live))
    return bool(wanted.get("type") == "Recreate" and there.get("rollingUpdate"))


def groups(writes: Sequence[Step]) -> list[list[Step]]:
    """Return steps in the order of apply; those of a group are applied at the same time."""

    def place(step: Step) -> tuple[int, bool]:
        return wave(step.ref.kind), not comes_first(step)

    return [[step for step in writes if place(step) == p] for p in sorted(set(map(place, writes)))]


TRIES = 10


def write(run: Run, manifest: Manifest, live: Manifest | None) -> Live:
    """Apply a manifest and return the resulting object.

    Args:
        live: what the plan saw, None for nothing.

    Raises:
        ConflictError: another object exists by now, or other managers own fields.
    """
    cluster, adopt, ref = run.cluster, run.options.adopt, ref_of(manifest)
    for again in range(TRIES):
        try:
            if live is not None and adopt and managers(live):
                live = own_all(cluster, ref, live)
            condition = choose_condition(ref, live, run.release)
            return cluster.apply(manifest, force=adopt, onto=condition)
        except Conflict as error:
            if error.fields or again == TRIES - 1:
                raise
            live = read_if_ours(cluster, ref, live, run.release)
    raise AssertionError("the last try returns or raises")


def make_namespace(cluster: Cluster, name: str) -> None:
    """Create a namespace if it does not exist."""
    manifest = describe_namespace(name)
    if cluster.get(ref_of(manifest)) is None:
        with suppress(ConflictError):  # another deploy was faster
            cluster.create(manifest)


def choose_condition(ref: ObjectRef, live: Manifest | None, release: ReleaseId) -> Onto:
    """Return the condition under which a manifest is applied.

    Controllers write the status of an object at any time, so an object of ours may have changed.
    One that belongs to no release must not: another release may be about to adopt it, too.
    """
    if ref.kind == "Namespace":  # releases share it
        return ANYTHING
    if live is None:
        return NOTHING
    return this_object(live) if belongs(live, release) else this_state(live)


def own_all(cluster: Cluster, ref: ObjectRef, live: Manifest) -> Live:
    """Make ours what other tools have set, so that what we leave out is removed."""
    meta = {
        "managedFields": take_over(live),
        "resourceVersion": live["metadata"]["resourceVersion"],
    }
    return cluster.patch(ref, {"metadata": meta})


def read_if_ours(
    cluster: Cluster, ref: ObjectRef, live: Manifest | None, release: ReleaseId
) -> Live | None:
    """Return what exists by now, if it is still ours to write.

    It is in two cases: our own first request arrived and only its answer was lost, or an object
    that is being adopted has a new status.

    Raises:
        ConflictError: it is not.
    """
    now = cluster.get(ref)
    if now is None:
        if live is None:
            return None
        raise ConflictError(
            f"{ref} was deleted by another program during this deploy", hint="run it again"
        )
    if belongs(now, release):
        return now
    if owner := describe_owner(now):
        raise ConflictError(
            f"{ref} belongs to another release ({owner}), which made it during this deploy",
            hint="choose another name for it, and run it again",
        )
    if live is not None and live["metadata"]["uid"] == now["metadata"]["uid"]:
        return now
    maker = ", ".join(managers(now)) or "another program"
    raise ConflictError(
        f"{ref} was made by {maker} during this deploy",
        hint="choose another name for it, or take it over with --adopt, and run it again",
    )

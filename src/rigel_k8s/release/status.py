"""Which parts of a release run where, and why something is not ready; it writes nothing."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.facts import is_ending, is_out_of_reach, is_ready
from rigel_k8s.objects.marks import NAME_LABEL, OPTIONAL_ANNOTATION, RELEASE_LABEL
from rigel_k8s.objects.podnodes import shared_pod, split
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release import revisions
from rigel_k8s.release.drift import describe_drift, describe_halt
from rigel_k8s.release.labelling import is_applied
from rigel_k8s.release.rollout.causes import (
    NOT_RUN,
    Cause,
    causes,
    containers,
    find_crash,
    find_liveness_failure,
    probe_failure,
)
from rigel_k8s.release.rollout.readiness import readiness, readiness_among
from rigel_k8s.release.rollout.view import Related, find_related
from rigel_k8s.release.sources import find_changed
from rigel_k8s.release.survey import belongs
from rigel_k8s.release.types import RUNNING, WORKLOADS, ReleaseId

Live = dict[str, Any]
#: The end of a probe's message, with which it names the kind of failure for programs.
KIND = re.compile(r"\[([a-z-]+)\]$")
#: The status of a revision for a user who may not read Secrets.
UNSEEN = "unseen"
#: The kind of a pod on a machine that Kubernetes has lost.
AWAY = "away"
KINDS = (
    *RUNNING,
    ("apps/v1", "ReplicaSet"),
    ("v1", "PersistentVolumeClaim"),
)
#: What nodes need beside that, of which only the names are read.
BESIDE = (("v1", "Service"), ("v1", "ConfigMap"))
#: What only people delete.
LASTING = {
    "Deployment",
    "DaemonSet",
    "StatefulSet",
    "PersistentVolumeClaim",
    "Service",
    "ConfigMap",
}


@attrs.frozen
class PodStatus:
    """One pod.

    Attributes:
        node: the machine that it runs on, "" before it has one.
        message: why it is not ready, "" if it is.
        kind: the kind of failure that its probe named, in brackets at the end of its message; AWAY
            if Kubernetes cannot reach its machine.
        created: when it was made, as Kubernetes writes times.
        image: that of its first container.
        stopped: when its liveness probe last stopped a container, as Kubernetes writes times; "" if
            a container has ended otherwise since then, or no event shows it.
        not_alive: what that probe reported.
        crashed, crash: the same where a container of a ready pod has ended by itself, and how.
    """

    name: str
    node: str
    ip: str
    phase: str
    ready: bool
    restarts: int
    message: str
    created: str
    image: str = ""
    kind: str = ""
    stopped: str = ""
    not_alive: str = ""
    crashed: str = ""
    crash: str = ""


@attrs.frozen
class WorkloadStatus:
    """One workload: how many pods are ready, how many it must have, and why not all are ready.

    One whose pods have several nodes is one for each of them.

    Attributes:
        name: its own, or that of the node in its pods.
        kinds: the kinds of the causes that `message` names (rollout/causes.py).
        halted: someone has stopped it, or its roll-outs (drift.py).
        drift: what others have changed in it, a sentence's end for each of them (drift.py).
        old_runs: its update is not complete, and pods of the version before it do its work.
    """

    kind: str
    name: str
    ready: int
    desired: int
    done: bool
    message: str
    pods: tuple[PodStatus, ...]
    annotations: Mapping[str, str] = attrs.field(factory=dict)
    kinds: tuple[str, ...] = ()
    drift: tuple[str, ...] = ()
    old_runs: bool = False
    halted: bool = False

    @property
    def ok(self) -> bool:
        """Whether it is as desired, or the release is good without it."""
        return self.done or self.annotations.get(OPTIONAL_ANNOTATION) == "true"


@attrs.frozen
class RolledBack:
    """A failed update: its revision, the one that was rolled back to, and why ("" if unknown)."""

    revision: int
    to: int
    cause: str


@attrs.frozen
class ReleaseStatus:
    """A release.

    Attributes:
        revision: the newest revision's number, 0 if it has none.
        revision_status: its status, "" if it has none, UNSEEN if we may not see revisions.
        good: the number of the newest revision that became ready, 0 if none is known.
        rolled_back: the last update, if it was rolled back.
        last_good: the record of the revision `good`, None without one.
        missing: what the newest revision has made and someone has deleted, in a sentence for each.
        changed: nodes whose variables come from what has changed since, in the same way.
    """

    release: ReleaseId
    revision: int
    revision_status: str
    workloads: tuple[WorkloadStatus, ...]
    good: int = 0
    rolled_back: RolledBack | None = None
    last_good: revisions.Record | None = attrs.field(default=None, eq=False, repr=False)
    missing: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()

    @property
    def ok(self) -> bool:
        """Whether all is there and as it is to be, and all that is required is ready."""
        return not (self.missing or self.changed) and all(
            workload.ok for workload in self.workloads
        )

    @property
    def keeps_old(self) -> bool:
        """Whether an update has failed and the version before still does the work."""
        failed = self.revision_status == "failed"
        return any(one.old_runs and (failed or one.kinds) for one in self.workloads)


def status(cluster: Cluster, release: ReleaseId) -> ReleaseStatus:
    """Return which parts of a release run where.

    Raises:
        UserError: nothing of it is on the cluster.
    """
    found, beside, records = collect(cluster, release)
    related = find_related(
        found.get("ReplicaSet", ()), found.get("Pod", ()), found.pop("Event", ())
    )
    described = describe_release(release, found.values(), related, records)
    if described is None:
        raise no_release_error(release)
    missing = find_missing(list_owned(records), {**found, **beside})
    workloads = [live for _, kind in RUNNING for live in found[kind] if belongs(live, release)]
    changed = find_changed(cluster, workloads, related.list_newest_pods)
    return attrs.evolve(described, missing=tuple(missing), changed=tuple(changed))


def list_owned(records: Sequence[revisions.Record] | None) -> Sequence[ObjectRef]:
    """Return what the newest revision has made; nothing if it is not good, or cannot be read."""
    if not records or records[-1].status != "good":
        return ()
    try:
        return [item.ref for item in records[-1].revision().inventory]
    except ClusterError:  # `history` reports it
        return ()


def find_missing(owned: Iterable[ObjectRef], found: Mapping[str, Iterable[Live]]) -> Iterator[str]:
    """Yield what a release owns and is not there any more, in a sentence for each; pure.

    Args:
        found: all that is there, by the kinds that were looked for.
    """
    there = {ref_of(live) for kind in found.values() for live in kind}
    for ref in owned:
        if ref.kind in LASTING & found.keys() and ref not in there:
            name = f"{ref.kind} {ref.name}"
            yield f"{name} is missing: someone has deleted it; `rigel run` makes it again"


def no_release_error(release: ReleaseId) -> UserError:
    return UserError(
        f"there is no release {release.name} in the namespace {release.namespace}",
        hint="-n NAMESPACE or --context NAME, if it is elsewhere; `rigel list -A` lists all",
    )


def describe_release(
    release: ReleaseId,
    found: Iterable[Iterable[Live]],
    related: Related,
    records: Sequence[revisions.Record] | None,
) -> ReleaseStatus | None:
    """Return what of a release runs where, None where there is nothing of it; pure.

    Args:
        found: objects with its label, by kind.
        related: pods, ReplicaSets and warnings of its namespace.
        records: its revisions; None for a user who may not see them.
    """
    owned = [live for kind in found for live in kind if is_applied(live)]
    workloads = [live for live in owned if belongs(live, release)]
    if not workloads and not records:
        return None
    good = revisions.find_good(records or ())
    revision, revision_status = newest(records)
    return ReleaseStatus(
        release=release,
        revision=revision,
        revision_status=revision_status,
        workloads=tuple(
            status
            for live in sorted(workloads, key=lambda live: str(live["metadata"]["name"]))
            if live["kind"] in WORKLOADS or not readiness(live).done
            for status in describe_nodes(live, related)
        ),
        good=good,
        rolled_back=describe_undone(records or ()),
        last_good=next((record for record in records or () if record.number == good), None),
    )


def describe_undone(records: Sequence[revisions.Record]) -> RolledBack | None:
    """Return the last update, if it has failed and the newest revision is a rollback from it."""
    newest = records[-1] if records else None
    if newest is None or newest.status != "good" or newest.back_to is None:
        return None
    update = next((record for record in reversed(records) if record.back_to is None), newest)
    undone = RolledBack(update.number, newest.back_to, update.failure)
    return undone if update.status == "failed" else None


def newest(records: Sequence[revisions.Record] | None) -> tuple[int, str]:
    """Return number and status of the newest revision."""
    if records is None:
        return 0, UNSEEN
    return (records[-1].number, records[-1].status) if records else (0, "")


def collect(
    cluster: Cluster, release: ReleaseId
) -> tuple[dict[str, list[Live]], dict[str, list[Live]], Sequence[revisions.Record] | None]:
    """Return the release's objects and its namespace's warnings; what is BESIDE; its records."""
    own = {RELEASE_LABEL: release.name}
    where = release.namespace

    def list_events() -> Sequence[Live]:
        try:
            return cluster.list("v1", "Event", where, fields="type=Warning")
        except ClusterError:  # without the right to see events less can be explained
            return ()

    def list_beside(api_version: str, kind: str) -> dict[str, list[Live]]:
        try:
            return {kind: cluster.list(api_version, kind, where, labels=own, metadata_only=True)}
        except Forbidden:  # a viewer
            return {}

    kinds = (*KINDS, ("v1", "Pod"))
    records, events, services, maps, *listed = cluster.gather(
        partial(list_records, cluster, release),
        list_events,
        *(partial(list_beside, *kind) for kind in BESIDE),
        *(partial(cluster.list, *kind, where, labels=own) for kind in kinds),
    )
    found = {kind: there for (_, kind), there in zip(kinds, listed, strict=True)}
    return {**found, "Event": events}, {**services, **maps}, records


def list_records(cluster: Cluster, release: ReleaseId) -> Sequence[revisions.Record] | None:
    """Return the release's records; None for a user who may see what runs but no Secrets."""
    try:
        return revisions.records(cluster, release)
    except Forbidden:
        return None


def describe_nodes(live: Manifest, related: Related) -> Iterator[WorkloadStatus]:
    """Yield the state of a workload, or of each node if its pods have several."""
    whole = describe_workload(live, related)
    for one in split(live):
        node = one["metadata"]["name"]
        if not shared_pod(one):
            yield whole
            continue
        parts = [choose_part(pod, node) for pod in related.list_pods(live)]
        newest = [choose_part(pod, node) for pod in related.list_newest_pods(live)]
        yield attrs.evolve(
            whole,
            name=node,
            ready=sum(map(is_ready, newest)),
            pods=describe_pods(parts, related),
            annotations=one["metadata"].get("annotations") or {},
        )


def describe_workload(live: Manifest, related: Related) -> WorkloadStatus:
    sets, pods = related.list_sets(live), related.list_pods(live)
    newest = related.list_newest_pods(live)
    state = readiness_among(live, newest, pods)
    message, wrong = state.message, list[Cause]()
    if not (state.done and state.ok):
        events = related.list_events(live, *sets, *pods)
        wrong = causes(live, newest, events, sets)
        message = "; ".join([message, *(cause.message for cause in wrong)])
    if halt := describe_halt(live):
        message = f"{halt}; `rigel run` with its Rigelfile puts it right"
    return WorkloadStatus(
        kind=live["kind"],
        name=live["metadata"]["name"],
        ready=state.ready,
        desired=state.wanted,
        done=state.done and state.ok and not halt,
        message=message,
        pods=describe_pods(pods, related),
        annotations=live["metadata"].get("annotations") or {},
        kinds=tuple(cause.kind for cause in wrong),
        drift=tuple(describe_drift(live)),
        old_runs=state.old_runs,
        halted=bool(halt),
    )


def describe_pods(pods: Iterable[Manifest], related: Related) -> tuple[PodStatus, ...]:
    """Return the state of pods, those that are being terminated last."""
    in_order = sorted(pods, key=lambda pod: (is_ending(pod), pod["metadata"]["name"]))
    return tuple(describe_pod(pod, related.list_events(pod)) for pod in in_order)


def choose_part(pod: Manifest, node: str) -> Manifest:
    """Return a node's part of a pod; the whole pod if it has none."""
    parts = {(part["metadata"].get("labels") or {}).get(NAME_LABEL): part for part in split(pod)}
    return parts.get(node, pod)


def describe_pod(pod: Manifest, events: Sequence[Manifest]) -> PodStatus:
    meta, spec, state = pod["metadata"], pod.get("spec") or {}, pod.get("status") or {}
    stopped, not_alive = find_liveness_failure(pod, events)
    crashed, crash = ("", "") if stopped else find_crash(pod)
    return PodStatus(
        name=meta["name"],
        node=spec.get("nodeName", ""),
        ip=state.get("podIP", ""),
        phase="Terminating" if is_ending(pod) else state.get("phase", "Unknown"),
        ready=is_ready(pod),
        restarts=sum(int(c.get("restartCount", 0)) for c in containers(state)),
        message="" if is_ready(pod) else explain_unready(pod, events, not_alive),
        created=meta.get("creationTimestamp", ""),
        image=next((c.get("image", "") for c in spec.get("containers") or []), ""),
        kind=find_kind(pod, events),
        stopped=stopped,
        not_alive=not_alive,
        crashed=crashed,
        crash=crash,
    )


def find_kind(pod: Manifest, events: Sequence[Manifest]) -> str:
    """Return the kind of failure that makes a pod unready, "" if it has no name."""
    if is_out_of_reach(pod):
        return AWAY
    named = KIND.search("" if is_ready(pod) else probe_failure(pod, events))
    return named.group(1) if named else ""


def explain_unready(pod: Manifest, events: Sequence[Manifest], not_alive: str = "") -> str:
    """Return why a pod is not ready; without the probe's report that ended its last life."""
    found = [cause.message for cause in causes(pod, [pod], events)]
    failure = probe_failure(pod, events)
    past = (not_alive and failure.endswith(not_alive)) or (found and NOT_RUN in failure)
    return "; ".join(filter(None, [*found, "" if past else failure]))

"""What is read from the cluster before a deploy's first write: dry runs, machines, our rights.

All requests are sent at once, and only if something is to be written. `verdict` decides what the
answers mean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.facts import is_empty_claim
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.rights import Right
from rigel_k8s.release.refusals.machines import find_homeless
from rigel_k8s.release.refusals.missing import look_for_missing
from rigel_k8s.release.refusals.needs import find_absent, find_needs
from rigel_k8s.release.refusals.rights import need_for
from rigel_k8s.release.refusals.trials import (
    Trial,
    changes_template,
    choose_trials,
    try_object,
    try_pod,
)
from rigel_k8s.release.types import Desired, Obstacle

Live = dict[str, Any]


@attrs.frozen
class Work:
    """What a deploy is about to do.

    Attributes:
        manifests: all of the release, prepared.
        candidates: those that may change something.
        live: what exists of the release.
        gone: what exists and is no longer desired.
        namespace: the release's namespace, None if it does not exist.
    """

    desired: Desired
    manifests: Sequence[Manifest]
    candidates: Sequence[Manifest]
    live: Mapping[ObjectRef, Live]
    gone: Sequence[Live]
    namespace: Live | None

    @property
    def in_reach(self) -> list[Manifest]:
        """The candidates that a dry run can try: none in a namespace that does not exist yet."""
        if self.namespace is not None:
            return list(self.candidates)
        return [m for m in self.candidates if not m["metadata"].get("namespace")]


@attrs.frozen
class Foreseen:
    """The cluster's answers.

    Attributes:
        results: by object: what apply would make of it, or why it would be refused.
        pods: by workload: its pod as the cluster would store it, or why it would be refused.
        missing: the rights that are missing.
        obstacles: why objects would not work although the API server accepts them.
    """

    results: Mapping[ObjectRef, Live | Refusal] = attrs.field(factory=dict)
    pods: Mapping[ObjectRef, Manifest | Refusal] = attrs.field(factory=dict)
    missing: Sequence[Right] = ()
    obstacles: Sequence[Obstacle] = ()


def foresee(cluster: Cluster, work: Work, *, adopt: bool) -> Foreseen:
    """Query the cluster, all at once.

    Raises:
        Forbidden: a dry run was refused because a right is missing.
        ClusterError: the cluster does not answer.
    """
    results: dict[ObjectRef, Live | Refusal] = {}
    pods: dict[ObjectRef, Manifest | Refusal] = {}
    missing: list[Right] = []
    obstacles: list[Obstacle] = []

    def try_one(manifest: Manifest) -> None:
        ref = ref_of(manifest)
        result = try_object(cluster, manifest, work.desired, adopt=adopt)
        if isinstance(result, Refusal) and result.status == 422 and replaces(manifest, work.live):
            result = dict(manifest)  # as new: the old one goes before
        results[ref] = result

    def try_its_pod(trial: Trial) -> None:
        if (answer := try_pod(cluster, trial)) is not None:
            pods.update(dict.fromkeys(trial.workloads, answer))

    needed = need_for(
        work.manifests,
        work.candidates,
        work.gone,
        work.desired.release.namespace,
        create_namespace=work.namespace is None and work.desired.create_namespace,
    )
    trials = choose_trials(work.in_reach, work.live, work.manifests)
    calls: list[Callable[[], None]] = [
        lambda: missing.extend(look_for_missing(cluster, needed, work.desired.release)),
        *(partial(try_one, manifest) for manifest in work.in_reach),
        *(partial(try_its_pod, trial) for trial in trials),
    ]
    changed = [m for m in work.candidates if changes_template(m, work.live)]
    if changed:
        calls.append(lambda: obstacles.extend(find_obstacles(cluster, work.desired, changed)))
    claims = [m for m in work.candidates if is_new_claim(m, work.live)]
    if needs := find_needs(changed, claims, work.manifests):
        calls.append(lambda: obstacles.extend(find_absent(cluster, needs)))
    cluster.parallel(lambda call: call(), calls)
    refs = [ref_of(manifest) for manifest in work.in_reach]
    in_order = {ref: results[ref] for ref in refs}
    tried = {ref: pods[ref] for ref in refs if ref in pods}
    return Foreseen(in_order, tried, missing, obstacles)


def find_obstacles(
    cluster: Cluster, desired: Desired, changed: Sequence[Manifest]
) -> Iterator[Obstacle]:
    """Yield why no machine can run workloads, and what the release's builder finds wrong."""
    try:
        nodes = cluster.nodes()
    except ClusterError:  # we may not see machines; the scheduler reports it later
        nodes = ()
    yield from find_homeless(changed, nodes)
    if desired.inspect is not None:
        yield from desired.inspect(changed, nodes)


def replaces(manifest: Manifest, live: Mapping[ObjectRef, Live]) -> bool:
    """Whether what exists may be deleted for its successor: a claim without a volume."""
    there = live.get(ref_of(manifest))
    return manifest["kind"] == "PersistentVolumeClaim" and bool(there and is_empty_claim(there))


def is_new_claim(manifest: Manifest, live: Mapping[ObjectRef, Live]) -> bool:
    """Whether a manifest is a claim that does not exist yet, or that is still without a volume."""
    if manifest["kind"] != "PersistentVolumeClaim":
        return False
    return ref_of(manifest) not in live or replaces(manifest, live)

"""What is read from the cluster before a deploy's first write: dry runs, machines, our rights.

All requests are sent at once, and only if something is to be written. `verdict` decides what the
answers mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
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
    changes_template,
    choose_trials,
    try_object,
    try_pod,
    try_successor,
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
    needed = need_for(
        work.manifests,
        work.candidates,
        [
            *work.gone,
            *(m for m in work.candidates if m["kind"] == "Job" and ref_of(m) in work.live),
        ],
        work.desired.release.namespace,
        create_namespace=work.namespace is None and work.desired.create_namespace,
    )
    trials = choose_trials(work.in_reach, work.live, work.manifests)
    changed = [m for m in work.candidates if changes_template(m, work.live)]
    claims = [m for m in work.candidates if is_new_claim(m, work.live)]
    found = find_needs(changed, claims, work.manifests)
    needs = {need: found[need] for need in found if need not in work.desired.beside}

    def try_one(manifest: Manifest) -> Live | Refusal:
        result = try_object(cluster, manifest, work.desired, adopt=adopt)
        if isinstance(result, Refusal) and replaces(manifest, work.live, result):
            # As new: the old one goes before.
            if manifest["kind"] == "Job":
                return try_successor(cluster, manifest, work.live[ref_of(manifest)])
            return dict(manifest)
        return result

    missing, obstacles, absent, *answers = cluster.gather(
        lambda: look_for_missing(cluster, needed, work.desired.release),
        lambda: list(find_obstacles(cluster, work.desired, changed)) if changed else [],
        lambda: list(find_absent(cluster, needs)) if needs else [],
        *(partial(try_one, manifest) for manifest in work.in_reach),
        *(partial(try_pod, cluster, trial) for trial in trials),
    )
    refs = [ref_of(manifest) for manifest in work.in_reach]
    results = dict(zip(refs, answers, strict=False))
    tried = {
        workload: answer
        for trial, answer in zip(trials, answers[len(refs) :], strict=True)
        if answer is not None
        for workload in trial.workloads
    }
    pods = {ref: tried[ref] for ref in refs if ref in tried}
    return Foreseen(results, pods, missing, [*obstacles, *absent])


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


def replaces(manifest: Manifest, live: Mapping[ObjectRef, Live], error: Refusal) -> bool:
    """Whether what exists is deleted for its successor: a claim without a volume, or a Job.

    Kubernetes never changes the pods of a Job: other pods are another run.
    """
    found = live.get(ref_of(manifest))
    if found is None or error.status != 422:
        return False
    if manifest["kind"] == "Job":
        return all("field is immutable" in cause.message for cause in error.causes)
    return is_empty_claim(found)


def is_new_claim(manifest: Manifest, live: Mapping[ObjectRef, Live]) -> bool:
    """Whether a manifest is a claim that does not exist yet, or that is still without a volume."""
    if manifest["kind"] != "PersistentVolumeClaim":
        return False
    found = live.get(ref_of(manifest))
    return found is None or is_empty_claim(found)

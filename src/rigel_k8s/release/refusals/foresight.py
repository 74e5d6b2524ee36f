"""What the cluster says of a deploy before its first write: dry runs, quotas, our own rights.

All of it is asked at once, and only where something is to be written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Conflict, Forbidden, Missing, Refusal
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.rights import Right
from rigel_k8s.release.refusals.rights import ask_missing, find_resource, missing_error, need_for
from rigel_k8s.release.refusals.trials import (
    ABOUT_OBJECTS,
    Trial,
    changes_template,
    choose_trials,
    try_pod,
)
from rigel_k8s.release.types import Desired, ReleaseId

Live = dict[str, Any]


@attrs.frozen
class Work:
    """What a deploy is about to do.

    Attributes:
        manifests: all of the release, prepared.
        candidates: those that may change something.
        live: what is there of the release.
        gone: what is there and not wanted any more.
        namespace: the release's namespace, None where it is not there.
    """

    desired: Desired
    manifests: Sequence[Manifest]
    candidates: Sequence[Manifest]
    live: Mapping[ObjectRef, Live]
    gone: Sequence[Live]
    namespace: Live | None

    @property
    def in_reach(self) -> list[Manifest]:
        """The candidates that a dry run can try: nothing is tried in a namespace to come."""
        if self.namespace is not None:
            return list(self.candidates)
        return [m for m in self.candidates if not m["metadata"].get("namespace")]


@attrs.frozen
class Foreseen:
    """What the cluster said.

    Attributes:
        results: by object: what apply would make of it, or why it would be refused.
        pods: by workload: its pod as the cluster would store it, or why it would be refused.
        quotas: the namespace's ResourceQuotas.
        missing: the rights that we lack.
        unfit: why workloads cannot run, as those say who know what is in the release.
    """

    results: Mapping[ObjectRef, Live | Refusal] = attrs.field(factory=dict)
    pods: Mapping[ObjectRef, Manifest | Refusal] = attrs.field(factory=dict)
    quotas: Sequence[Live] = ()
    missing: Sequence[Right] = ()
    unfit: Mapping[ObjectRef, str] = attrs.field(factory=dict)


def foresee(cluster: Cluster, work: Work, *, adopt: bool) -> Foreseen:
    """Ask the cluster, all at once.

    Raises:
        Forbidden: a dry run was refused because we lack a right.
        ClusterError: the cluster does not answer.
    """
    results: dict[ObjectRef, Live | Refusal] = {}
    pods: dict[ObjectRef, Manifest | Refusal] = {}
    quotas: list[Live] = []
    missing: list[Right] = []
    unfit: dict[ObjectRef, str] = {}
    release, there = work.desired.release, work.namespace is not None

    def try_one(manifest: Manifest) -> None:
        results[ref_of(manifest)] = try_object(cluster, manifest, work.desired, adopt=adopt)

    def try_its_pod(trial: Trial) -> None:
        if (answer := try_pod(cluster, trial)) is not None:
            pods.update(dict.fromkeys(trial.workloads, answer))

    trials = choose_trials(work.in_reach, work.live, work.manifests)
    calls: list[Callable[[], None]] = [
        lambda: missing.extend(look_for_missing(cluster, list_needed(work), release)),
        *(partial(try_one, manifest) for manifest in work.in_reach),
        *(partial(try_its_pod, trial) for trial in trials),
    ]
    inspect = work.desired.inspect
    changed = [m for m in work.candidates if changes_template(m, work.live)]
    if inspect is not None and changed:
        calls.append(lambda: unfit.update(inspect(changed)))
    if there and work.candidates:
        calls.append(lambda: quotas.extend(list_quotas(cluster, release.namespace)))
    cluster.parallel(lambda call: call(), calls)
    refs = [ref_of(manifest) for manifest in work.in_reach]
    in_order = {ref: results[ref] for ref in refs}
    tried = {ref: pods[ref] for ref in refs if ref in pods}
    return Foreseen(in_order, tried, quotas, missing, unfit)


def list_needed(work: Work) -> set[Right]:
    """Return all rights that the deploy needs."""
    return need_for(
        work.manifests,
        work.candidates,
        work.gone,
        work.desired.release.namespace,
        create_namespace=work.namespace is None and work.desired.create_namespace,
    )


def list_quotas(cluster: Cluster, namespace: str) -> Sequence[Live]:
    """Return a namespace's quotas; none where we may not see them."""
    try:
        return cluster.list("v1", "ResourceQuota", namespace)
    except ClusterError:
        return []


@contextmanager
def listing_missing_rights(
    cluster: Cluster, desired: Desired, manifests: Sequence[Manifest]
) -> Iterator[None]:
    """Turn the refusal for the first right that is missing into one for all of them."""
    try:
        yield
    except Forbidden as error:
        if error.ground != "right":
            raise
        needed = need_for(manifests, manifests, (), desired.release.namespace)
        missing = look_for_missing(cluster, needed, desired.release)
        if not missing:
            raise
        raise explain_missing(desired, missing) from error


def look_for_missing(
    cluster: Cluster, needed: Iterable[Right], release: ReleaseId
) -> Sequence[Right]:
    """Return the rights that we lack; none where the cluster does not say what we may do."""
    try:
        return ask_missing(cluster, needed, release.namespace)
    except ClusterError:
        return []


def explain_missing(desired: Desired, missing: Sequence[Right]) -> Forbidden:
    """Return the error for missing rights, with the way out that is known for a kind of object."""
    lacking = {(right.group, right.resource) for right in missing}
    known = [
        desired.remedies[manifest["kind"]]
        for manifest in desired.objects
        if manifest["kind"] in desired.remedies and lacks(manifest, lacking)
    ]
    where = desired.release.namespace
    grant = f"`rigel -n {where} rbac deployer --user YOU | kubectl apply -f -`"
    usual = f"ask an administrator for them: {grant} grants all that deploys need"
    hint = known[0] if known else usual
    return missing_error(missing, f"deploy {desired.release.name} to {where}", hint)


def lacks(manifest: Manifest, lacking: set[tuple[str, str]]) -> bool:
    """Whether a right for an object's kind is among those that are missing."""
    resource = find_resource(manifest["apiVersion"], manifest["kind"])
    group = str(manifest["apiVersion"]).rpartition("/")[0]
    return resource is not None and (group, resource.plural) in lacking


@contextmanager
def naming_remedy(desired: Desired, kind: str) -> Iterator[None]:
    """Give the error of a missing right for a kind of object the way out that is known for it."""
    try:
        yield
    except Forbidden as error:
        if error.ground == "right":
            error.hint = desired.remedies.get(kind, error.hint)
        raise


def try_object(
    cluster: Cluster, manifest: Manifest, desired: Desired, *, adopt: bool
) -> Live | Refusal:
    """Return what applying a manifest would make of it, or why it would be refused.

    An object whose kind this very deploy defines cannot be tried, and is taken for a new one.
    """
    try:
        with naming_remedy(desired, manifest["kind"]):
            return cluster.apply(manifest, force=adopt, dry_run=True)
    except Missing as error:
        return dict(manifest) if defines(desired, manifest) else error
    except Refusal as error:
        if error.status == 400 and "dry run" in error.message:
            return assume_result(cluster, manifest)
        if error.status == 422 and "spec.strategy.rollingUpdate" in error.message:
            return assume_result(cluster, manifest)  # apply ends the old strategy before
        if not is_about_object(error):
            raise
        return error


def assume_result(cluster: Cluster, manifest: Manifest) -> Live:
    """Return what stands for a dry run that says nothing of the deploy."""
    live = cluster.get(ref_of(manifest))
    version = live["metadata"]["resourceVersion"] if live else ""
    meta: dict[str, Any] = {**manifest["metadata"], "resourceVersion": version}
    return {**manifest, "metadata": meta}


def defines(desired: Desired, manifest: Manifest) -> bool:
    """Whether the release itself defines an object's kind."""
    group = manifest["apiVersion"].partition("/")[0]
    return any(
        (m["spec"]["group"], m["spec"]["names"]["kind"]) == (group, manifest["kind"])
        for m in desired.objects
        if m["kind"] == "CustomResourceDefinition"
    )


def is_about_object(error: Refusal) -> bool:
    """Whether a refusal is about what the object asks for, not about us or the moment.

    A conflict that names no field is about the moment: someone else wrote the object just then.
    """
    if isinstance(error, Conflict):
        return bool(error.fields)
    if isinstance(error, Forbidden) and error.ground in ABOUT_OBJECTS:
        return True
    return error.status == 422 or "can be resized" in error.message

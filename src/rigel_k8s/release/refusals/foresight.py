"""What is read from the cluster before a deploy's first write: dry runs, machines, our rights.

All requests are sent at once, and only if something is to be written. `verdict` decides what the
answers mean.
"""

from __future__ import annotations

import json
import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Conflict, Forbidden, Missing, Refusal
from rigel_k8s.objects.facts import is_empty_claim
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.rights import Right
from rigel_k8s.release.refusals.missing import look_for_missing, naming_remedy, need_for
from rigel_k8s.release.refusals.needs import find_absent, find_homeless, find_needs
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


#: What of a 403 is about the object; every other one is about the caller, or not understood.
ABOUT_OBJECTS = ("pod-security", "quota", "no-resources", "limit-range", "policy")
#: What a dry run refuses because of another manager's strategy, which apply ends before.
OLD_STRATEGY = "spec.strategy.rollingUpdate"


@attrs.frozen
class TriedPod:
    """A pod that is tried, and the workloads whose template it is made from."""

    pod: Manifest
    workloads: tuple[ObjectRef, ...]


def choose_trials(
    candidates: Iterable[Manifest],
    live: Mapping[ObjectRef, Manifest],
    manifests: Iterable[Manifest],
) -> list[TriedPod]:
    """Return the pods to try: one for each template that the cluster does not have yet.

    Args:
        candidates: the manifests that may change something.
        manifests: all of the release. A service account among them may not exist yet, and a pod of
            an unknown account is always refused: so the pod is tried without it.
    """
    accounts = {m["metadata"]["name"] for m in manifests if m["kind"] == "ServiceAccount"}
    chosen: dict[str, list[Manifest]] = {}
    for manifest in candidates:
        if changes_template(manifest, live):
            template = manifest["spec"]["template"]
            key = json.dumps([manifest["metadata"].get("namespace"), template], sort_keys=True)
            chosen.setdefault(key, []).append(manifest)
    return [
        TriedPod(make_pod(same[0], accounts), tuple(ref_of(manifest) for manifest in same))
        for same in chosen.values()
    ]


def changes_template(manifest: Manifest, live: Mapping[ObjectRef, Manifest]) -> bool:
    """Whether a workload gets a pod template that the cluster does not have yet."""
    template = find_template(manifest)
    there = find_template(live.get(ref_of(manifest), {}))
    return template is not None and not (there and contains(there, template))


def find_template(workload: Manifest) -> Manifest | None:
    """Return the template of which a workload makes pods, None if it makes none."""
    if workload.get("kind") not in ("Deployment", "DaemonSet", "StatefulSet", "Job"):
        return None
    template: Manifest = workload["spec"]["template"]
    return template


def contains(live: object, wanted: object) -> bool:
    """Whether a live value contains all that is wanted; Kubernetes adds its defaults to it."""
    if isinstance(wanted, Mapping):
        return isinstance(live, Mapping) and all(
            contains(live.get(key), part) for key, part in wanted.items() if part is not None
        )
    if isinstance(wanted, list):
        return (
            isinstance(live, list)
            and len(live) == len(wanted)
            and all(contains(*pair) for pair in zip(live, wanted, strict=True))
        )
    return live == wanted


def make_pod(workload: Manifest, accounts: Collection[str]) -> dict[str, Any]:
    """Return the pod that a workload's controller would make."""
    template, name = workload["spec"]["template"], workload["metadata"]["name"]
    spec = dict(template["spec"])
    if spec.get("serviceAccountName") in accounts:
        spec.pop("serviceAccountName")
        spec.pop("serviceAccount", None)
    given = template.get("metadata") or {}  # a Job's template needs none
    meta = {key: given.get(key) or {} for key in ("labels", "annotations")}
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {
            **meta,
            "generateName": f"{name}-",
            "namespace": workload["metadata"].get("namespace"),
        },
        "spec": spec,
    }


def try_pod(cluster: Cluster, trial: TriedPod) -> Manifest | Refusal | None:
    """Return the pod as the cluster would store it, why it would refuse it, or None: unknown.

    It is unknown if we may not create pods, if a webhook does not support dry runs, and if the
    cluster does not answer: none of these prevents a deploy from working.
    """
    try:
        return cluster.create(trial.pod, dry_run=True)
    except Forbidden as error:
        return error if error.ground in ABOUT_OBJECTS else None
    except Refusal as error:
        return error if error.status == 422 else None


def try_object(
    cluster: Cluster, manifest: Manifest, desired: Desired, *, adopt: bool
) -> Live | Refusal:
    """Return what applying a manifest would make of it, or why it would be refused.

    An object whose kind this very deploy defines cannot be tried, and counts as a new one. Nor can
    a binding of a Role that does not exist yet: for a user without the right to bind any Role,
    Kubernetes looks up what the Role grants.
    """
    try:
        with naming_remedy(desired, manifest["kind"]):
            return cluster.apply(manifest, force=adopt, dry_run=True)
    except Missing as error:
        if binds_own_role(desired, manifest):
            return assume_result(cluster, manifest)
        return dict(manifest) if defines(desired, manifest) else error
    except Refusal as error:
        if error.status == 400 and "dry run" in error.message:
            return assume_result(cluster, manifest)
        if {cause.field for cause in error.causes} == {OLD_STRATEGY}:
            return assume_result(cluster, manifest)
        if not is_about_object(error):
            raise
        return error


def try_successor(cluster: Cluster, manifest: Manifest, live: Manifest) -> Live | Refusal:
    """Return a Job as it would be when the live one has gone, or why it would be refused.

    It is tried under another name; by what Kubernetes derives from names and UIDs, both are alike.
    """
    meta = manifest["metadata"]
    name = f"{meta['name'][:50]}-{uuid.uuid4().hex[:8]}"
    try:
        made = cluster.apply({**manifest, "metadata": {**meta, "name": name}}, dry_run=True)
    except Refusal as error:
        return error
    text = json.dumps(made).replace(name, meta["name"])
    found: Live = json.loads(text.replace(made["metadata"]["uid"], live["metadata"]["uid"]))
    found["metadata"].pop("resourceVersion", None)
    return found


def assume_result(cluster: Cluster, manifest: Manifest) -> Live:
    """Return a substitute for a dry run whose answer does not apply to the deploy."""
    live = cluster.get(ref_of(manifest))
    version = live["metadata"]["resourceVersion"] if live else ""
    meta: dict[str, Any] = {**manifest["metadata"], "resourceVersion": version}
    return {**manifest, "metadata": meta}


def defines(desired: Desired, manifest: Manifest) -> bool:
    """Whether the release itself, or what is deployed before it, defines an object's kind."""
    group = manifest["apiVersion"].partition("/")[0]
    return (group, manifest["kind"]) in desired.defined or any(
        (m["spec"]["group"], m["spec"]["names"]["kind"]) == (group, manifest["kind"])
        for m in desired.objects
        if m["kind"] == "CustomResourceDefinition"
    )


def binds_own_role(desired: Desired, manifest: Manifest) -> bool:
    """Whether a manifest binds a Role of the release itself."""
    role = manifest.get("roleRef") or {}
    return any(
        (m["kind"], m["metadata"]["name"]) == (role.get("kind"), role.get("name"))
        for m in desired.objects
    )


def is_about_object(error: Refusal) -> bool:
    """Whether a refusal is about what the object requests, not about us or the moment.

    A conflict that names no field is about the moment: another program has just written the object.
    """
    if isinstance(error, Conflict):
        return bool(error.fields)
    if isinstance(error, Forbidden) and error.ground in ABOUT_OBJECTS:
        return True
    return error.status == 422 or "can be resized" in error.message

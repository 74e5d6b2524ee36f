"""What is on the cluster before a deploy, in as few requests as possible; it writes nothing.

One LIST for each kind of object, one for the revisions. Only what is new, or what the hash and the
owned fields do not tell unchanged, is sent as a server-side dry run. Whatever the cluster would
refuse is thus known before anything is applied.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Conflict, Forbidden, Missing, Refusal
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.lease import lease_ref
from rigel_k8s.release.ownership import covers
from rigel_k8s.release.prepare import NAMESPACE_ANNOTATION, hash_of, manifests_to_apply
from rigel_k8s.release.revisions import Record, records
from rigel_k8s.release.types import Desired, InventoryItem, ReleaseId, Revision

Live = dict[str, Any]


@attrs.frozen
class Survey:
    """The cluster as a deploy finds it.

    Attributes:
        manifests: what shall be, prepared, in the order of apply.
        live: what is there of it, and of what the last revision had.
        results: what the dry runs answered: an object, or why not.
        namespace: the release's namespace, None where it is not there.
        history: the records of the release, the oldest first.
        last: the newest revision, None where there is none.
        lease: the Lease of a deploy that is under way or was killed, None where there is none.
    """

    desired: Desired
    manifests: tuple[Manifest, ...]
    live: Mapping[ObjectRef, Live]
    results: Mapping[ObjectRef, Live | Refusal]
    namespace: Live | None
    history: Sequence[Record]
    last: Revision | None
    lease: Live | None = None

    @property
    def inventory(self) -> tuple[InventoryItem, ...]:
        """What the release owns: a pending or failed revision has old and new in its own."""
        return self.last.inventory if self.last else ()

    @property
    def next_number(self) -> int:
        """The number of the revision to come."""
        return self.history[-1].number + 1 if self.history else 1


def namespace_ref(release: ReleaseId) -> ObjectRef:
    """Return the reference of a release's namespace."""
    return ObjectRef("v1", "Namespace", "", release.namespace)


def survey(cluster: Cluster, desired: Desired, *, adopt: bool) -> Survey:
    """Look at the cluster.

    Args:
        adopt: fields of other managers would be taken over.

    Raises:
        ClusterError: the namespace is missing (and is not to be created) or is being deleted.
    """
    manifests = manifests_to_apply(desired)
    namespace, history, live, lease = list_objects(cluster, desired, manifests)
    check_namespace(desired, namespace)
    last = history[-1].revision() if history else None
    live |= find_left_over(cluster, live, manifests, last)
    candidates = [m for m in manifests if not is_unchanged(m, live.get(ref_of(m)))]
    if namespace is None:
        candidates = [m for m in candidates if not m["metadata"].get("namespace")]
    results = try_candidates(cluster, candidates, desired, adopt=adopt)
    live |= find_strangers(cluster, live, results)
    return Survey(desired, manifests, live, results, namespace, history, last, lease)


def list_objects(
    cluster: Cluster, desired: Desired, manifests: Iterable[Manifest]
) -> tuple[Live | None, list[Record], dict[ObjectRef, Live], Live | None]:
    """Return the namespace, the history, the release's objects of the wanted kinds, the Lease."""
    release = desired.release
    namespace: list[Live | None] = []
    lease: list[Live | None] = []
    history: list[Record] = []
    found: dict[ObjectRef, Live] = {}

    def objects(api_version: str, kind: str, where: str) -> None:
        labels = {RELEASE_LABEL: release.name}
        with naming_remedy(desired, kind):
            there = cluster.list(api_version, kind, where, labels=labels)
        found.update({ref_of(live): live for live in there if belongs(live, release)})

    kinds = {(m["apiVersion"], m["kind"], m["metadata"].get("namespace", "")) for m in manifests}
    work: list[Callable[[], None]] = [
        lambda: namespace.append(cluster.get(namespace_ref(release))),
        lambda: lease.append(cluster.get(lease_ref(release))),
        lambda: history.extend(records(cluster, release)),
        *(lambda kind=kind: objects(*kind) for kind in sorted(kinds)),
    ]
    cluster.parallel(lambda call: call(), work)
    return namespace[0], history, found, lease[0]


@contextmanager
def naming_remedy(desired: Desired, kind: str) -> Iterator[None]:
    """Give the error of a missing right for a kind of object the way out that is known for it."""
    try:
        yield
    except Forbidden as error:
        error.hint = desired.remedies.get(kind, error.hint)
        raise


def belongs(live: Manifest, release: ReleaseId) -> bool:
    """Whether an object says that it is of this very release."""
    meta = live["metadata"]
    if (meta.get("labels") or {}).get(RELEASE_LABEL) != release.name:
        return False
    annotations = meta.get("annotations") or {}
    return bool(meta.get("namespace") or annotations.get(NAMESPACE_ANNOTATION) == release.namespace)


def check_namespace(desired: Desired, namespace: Live | None) -> None:
    """Raise where nothing can be put into the release's namespace."""
    name = desired.release.namespace
    if namespace is None and not desired.create_namespace and desired.objects:
        raise ClusterError(
            f"there is no namespace {name}",
            hint=f"name it in the Rigelfile, which creates it, or: kubectl create namespace {name}",
        )
    if namespace is not None and namespace["metadata"].get("deletionTimestamp"):
        raise ClusterError(
            f"the namespace {name} is being deleted",
            hint=f"wait for its end: kubectl wait --for=delete namespace/{name}",
        )


def find_left_over(
    cluster: Cluster,
    live: Mapping[ObjectRef, Live],
    manifests: Iterable[Manifest],
    last: Revision | None,
) -> dict[ObjectRef, Live]:
    """Return what the last revision owns and nobody wants any more, as far as it is there."""
    wanted = {ref_of(m) for m in manifests}
    items = last.inventory if last else ()
    refs = [item.ref for item in items if item.ref not in wanted and item.ref not in live]
    found = zip(refs, cluster.parallel(cluster.get, refs), strict=True)
    return {ref: there for ref, there in found if there is not None}


def is_unchanged(manifest: Manifest, live: Manifest | None) -> bool:
    """Whether a live object is what a manifest says, by its hash and the fields that we own."""
    if live is None or live["metadata"].get("deletionTimestamp"):
        return False
    return hash_of(live) == hash_of(manifest) and covers(manifest, live)


def try_candidates(
    cluster: Cluster, candidates: Sequence[Manifest], desired: Desired, *, adopt: bool
) -> dict[ObjectRef, Live | Refusal]:
    """Return what applying each candidate would make of it, or why it would be refused.

    An object whose kind this very deploy defines cannot be tried, and is taken for a new one.
    """
    defined = {
        (m["spec"]["group"], m["spec"]["names"]["kind"])
        for m in desired.objects
        if m["kind"] == "CustomResourceDefinition"
    }

    def try_one(manifest: Manifest) -> Live | Refusal:
        try:
            with naming_remedy(desired, manifest["kind"]):
                return cluster.apply(manifest, force=adopt, dry_run=True)
        except Missing as error:
            group = manifest["apiVersion"].partition("/")[0]
            if (group, manifest["kind"]) in defined:
                return dict(manifest)
            return error
        except Refusal as error:
            if error.status == 400 and "dry run" in error.message:
                return assume_result(cluster, manifest)
            if error.status == 422 and "spec.strategy.rollingUpdate" in error.message:
                return assume_result(cluster, manifest)  # apply ends the old strategy before
            if not is_about_object(error):
                raise
            return error

    refs = [ref_of(m) for m in candidates]
    return dict(zip(refs, cluster.parallel(try_one, candidates), strict=True))


def assume_result(cluster: Cluster, manifest: Manifest) -> Live:
    """Return what stands for a dry run that says nothing of the deploy."""
    live = cluster.get(ref_of(manifest))
    version = live["metadata"]["resourceVersion"] if live else ""
    meta: dict[str, Any] = {**manifest["metadata"], "resourceVersion": version}
    return {**manifest, "metadata": meta}


def is_about_object(error: Refusal) -> bool:
    """Whether a refusal is about what the object asks for, not about us or the moment.

    A conflict that names no field is about the moment: someone else wrote the object just then.
    """
    if isinstance(error, Conflict):
        return bool(error.fields)
    told = "quota" in error.message or "can be resized" in error.message
    return error.status == 422 or told


def find_strangers(
    cluster: Cluster, live: Mapping[ObjectRef, Live], results: Mapping[ObjectRef, Live | Refusal]
) -> dict[ObjectRef, Live]:
    """Return objects with our names that are not labelled as ours.

    A dry run answers with a resourceVersion only where the object exists.
    """
    refs = [
        ref
        for ref, result in results.items()
        if ref not in live
        and (
            isinstance(result, Refusal)
            or (not isinstance(result, Refusal) and result["metadata"].get("resourceVersion"))
        )
    ]
    found = zip(refs, cluster.parallel(cluster.get, refs), strict=True)
    return {ref: there for ref, there in found if there is not None}

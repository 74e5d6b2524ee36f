"""What is on the cluster before a deploy, in as few requests as possible; it writes nothing.

One LIST for each kind of object, one for the revisions. Only what is new, or what is changed
according to the hash and the owned fields, is sent as a server-side dry run, with the pods that it
would make; machines and our rights are read at the same time. So what the cluster would refuse is
known before anything is applied, and an unchanged release costs nothing for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.drift import find_drift, remove_drift
from rigel_k8s.release.labelling import NAMESPACE_ANNOTATION, covers, hash_of, manifests_to_apply
from rigel_k8s.release.locking import lease_ref
from rigel_k8s.release.refusals.foresight import (
    Foreseen,
    Work,
    foresee,
)
from rigel_k8s.release.refusals.missing import listing_missing_rights, naming_remedy
from rigel_k8s.release.revisions import Record, records
from rigel_k8s.release.types import PROTECTED, Desired, InventoryItem, ReleaseId, Revision

Live = dict[str, Any]


@attrs.frozen
class Survey:
    """The cluster as a deploy finds it.

    Attributes:
        manifests: what is desired, prepared, in the order of apply.
        live: what exists of it, and of what the last revision had.
        foreseen: the result of dry runs and rights.
        namespace: the release's namespace, None if it does not exist.
        history: the records of the release, the oldest first.
        last: the newest revision, None if it has none.
        lease: the Lease of a deploy that is in progress or was killed, None without one.
    """

    desired: Desired
    manifests: tuple[Manifest, ...]
    live: Mapping[ObjectRef, Live]
    foreseen: Foreseen
    namespace: Live | None
    history: Sequence[Record]
    last: Revision | None
    lease: Live | None = None

    @property
    def results(self) -> Mapping[ObjectRef, Live | Refusal]:
        """The answers of its objects' dry runs: an object, or why not."""
        return self.foreseen.results

    @property
    def inventory(self) -> tuple[InventoryItem, ...]:
        """What the release owns: a pending or failed revision has old and new in its own."""
        return self.last.inventory if self.last else ()

    @property
    def elsewhere(self) -> str:
        """The folder that the last revision came from, "" if it is this one or not known.

        Earlier versions have recorded paths that depend on where they were run.
        """
        here, there = self.desired.source, self.last.source if self.last else ""
        return there if there.startswith("/") and here not in ("", there) else ""

    @property
    def next_number(self) -> int:
        return self.history[-1].number + 1 if self.history else 1


def namespace_ref(release: ReleaseId) -> ObjectRef:
    """Return the reference of a release's namespace."""
    return ObjectRef("v1", "Namespace", "", release.namespace)


def describe_namespace(name: str) -> dict[str, Any]:
    """Return a namespace's manifest."""
    return {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}}


def survey(cluster: Cluster, desired: Desired, *, adopt: bool) -> Survey:
    """Look at the cluster.

    Args:
        adopt: fields of other managers would be taken over.

    Raises:
        ClusterError: the namespace is missing (and will not be created) or is being deleted.
    """
    manifests = manifests_to_apply(desired)
    with listing_missing_rights(cluster, desired, manifests):
        namespace, history, live, lease = list_objects(cluster, desired, manifests)
        check_namespace(desired, namespace)
        last = history[-1].revision() if history else None
        live |= find_left_over(cluster, live, manifests, last)
        gone = choose_gone(live, manifests, last)
        candidates = [
            m
            for m in manifests
            if not is_unchanged(m, there := live.get(ref_of(m)))
            or (adopt and there is not None and find_drift(there))
        ]
        foreseen = Foreseen()
        if candidates or gone or last is None or last.status != "good":
            work = Work(desired, manifests, candidates, live, gone, namespace)
            foreseen = foresee(cluster, work, adopt=adopt)
            if adopt:
                results = foreseen.results.items()
                left = {ref: r if isinstance(r, Refusal) else remove_drift(r) for ref, r in results}
                foreseen = attrs.evolve(foreseen, results=left)
        live |= find_strangers(cluster, live, foreseen.results)
    return Survey(desired, manifests, live, foreseen, namespace, history, last, lease)


def list_objects(
    cluster: Cluster, desired: Desired, manifests: Iterable[Manifest]
) -> tuple[Live | None, list[Record], dict[ObjectRef, Live], Live | None]:
    """Return the namespace, the history, the release's objects of the wanted kinds, the Lease."""
    release = desired.release

    def list_kind(api_version: str, kind: str, where: str) -> Sequence[Live]:
        labels = {RELEASE_LABEL: release.name}
        with naming_remedy(desired, kind):
            return cluster.list(api_version, kind, where, labels=labels)

    kinds = {(m["apiVersion"], m["kind"], m["metadata"].get("namespace", "")) for m in manifests}
    queries: list[Callable[[], Any]] = [
        partial(cluster.get, namespace_ref(release)),
        partial(cluster.get, lease_ref(release)),
        partial(records, cluster, release),
        *(partial(list_kind, *kind) for kind in sorted(kinds)),
    ]
    namespace, lease, history, *listed = cluster.gather(*queries)
    found = {ref_of(one): one for there in listed for one in there if belongs(one, release)}
    return namespace, history, found, lease


def belongs(live: Manifest, release: ReleaseId) -> bool:
    """Whether an object is labelled as part of this very release."""
    meta = live["metadata"]
    if (meta.get("labels") or {}).get(RELEASE_LABEL) != release.name:
        return False
    annotations = meta.get("annotations") or {}
    return bool(meta.get("namespace") or annotations.get(NAMESPACE_ANNOTATION) == release.namespace)


def describe_owner(live: Manifest) -> str:
    """Return the release that an object is labelled as part of, "" for none.

    An object of the whole cluster may belong to a release of the same name elsewhere.
    """
    meta = live["metadata"]
    name = (meta.get("labels") or {}).get(RELEASE_LABEL, "")
    namespace = (meta.get("annotations") or {}).get(NAMESPACE_ANNOTATION)
    return f"{name} in {namespace}" if name and namespace else name


def check_namespace(desired: Desired, namespace: Live | None) -> None:
    """Raise if nothing can be put into the release's namespace."""
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
    """Return what the last revision owns and is no longer desired, as far as it exists."""
    wanted = {ref_of(m) for m in manifests}
    items = last.inventory if last else ()
    refs = [item.ref for item in items if item.ref not in wanted and item.ref not in live]
    found = zip(refs, cluster.parallel(cluster.get, refs), strict=True)
    return {ref: there for ref, there in found if there is not None}


def choose_gone(
    live: Mapping[ObjectRef, Live], manifests: Iterable[Manifest], last: Revision | None
) -> list[Live]:
    """Return what exists of the last revision and will be deleted, except what holds data."""
    owned = {item.ref for item in (last.inventory if last else ())}
    going = owned - {ref_of(manifest) for manifest in manifests}
    return [o for ref, o in live.items() if ref in going and ref.kind not in PROTECTED]


def is_unchanged(manifest: Manifest, live: Manifest | None) -> bool:
    """Whether a live object is as its manifest, by its hash and the fields that we own."""
    if live is None or live["metadata"].get("deletionTimestamp"):
        return False
    return hash_of(live) == hash_of(manifest) and covers(manifest, live)


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

"""What the end of a release deletes: everything it owns, except what holds data.

What it owns is in its last revision; what carries its label and our ownership counts too, so that
claims which an earlier `down` has kept can still be deleted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release import revisions
from rigel_k8s.release.labelling import is_applied
from rigel_k8s.release.locking import lease_ref
from rigel_k8s.release.plan import prunes
from rigel_k8s.release.survey import belongs, namespace_ref
from rigel_k8s.release.types import RUNNING, InventoryItem, Plan, ReleaseId

Live = dict[str, Any]
#: Kinds that are looked through for the release's label, beside those of its last revision.
KINDS = (
    *RUNNING,
    ("v1", "Service"),
    ("v1", "ConfigMap"),
    ("v1", "Secret"),
    ("v1", "PersistentVolumeClaim"),
    ("v1", "PersistentVolume"),
)


def find_records(cluster: Cluster, release: ReleaseId) -> tuple[ObjectRef, ...]:
    """Return what a release keeps about itself: revisions, and the Lease of a deploy."""
    if cluster.get(namespace_ref(release)) is None:
        return ()
    records = [record.ref for record in revisions.records(cluster, release)]
    lease = lease_ref(release)
    if cluster.get(lease) is not None:
        records.append(lease)  # of a deploy that is in progress or was killed
    return tuple(records)


def make_plan(
    cluster: Cluster, release: ReleaseId, records: Sequence[ObjectRef], *, volumes: bool
) -> Plan:
    """Return the deletion of all that exists of a release.

    Args:
        volumes: also of claims and volumes, with their data.
    """
    live = find_objects(cluster, release)
    items = [InventoryItem(ref, there["metadata"]["uid"]) for ref, there in live.items()]
    steps = tuple(prunes(items, live, (), release, volumes=volumes))
    return Plan(release, steps, tuple(records))


def find_objects(cluster: Cluster, release: ReleaseId) -> Mapping[ObjectRef, Live]:
    if cluster.get(namespace_ref(release)) is None:
        return {}
    records = revisions.records(cluster, release)
    inventory = records[-1].revision().inventory if records else ()
    found: dict[ObjectRef, Live] = {}

    def list_kind(kind: tuple[str, str]) -> None:
        try:
            there = cluster.list(*kind, release.namespace, labels={RELEASE_LABEL: release.name})
        except Forbidden:  # what we may not see was not made by us
            return
        found.update({ref_of(o): o for o in there if belongs(o, release) and is_applied(o)})

    cluster.parallel(list_kind, KINDS)
    refs = [item.ref for item in inventory if item.ref not in found]
    uids = {item.ref: item.uid for item in inventory}
    for ref, live in zip(refs, cluster.parallel(cluster.get, refs), strict=True):
        if live is not None and (live["metadata"]["uid"] == uids[ref] or belongs(live, release)):
            found[ref] = live
    return found

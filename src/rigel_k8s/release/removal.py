"""The end of a release: everything it owns is deleted, except what holds data.

What it owns is in its last revision; what carries its label and our ownership counts too, so that
claims which an earlier `down` has kept can still be deleted. It plans, deletes and waits as a
deploy of nothing, but does not look for refusals and leaves no revision.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release import revisions
from rigel_k8s.release.apply import CLAIMS, Applier
from rigel_k8s.release.lease import lease_ref
from rigel_k8s.release.locking import hold
from rigel_k8s.release.order import RUNNING
from rigel_k8s.release.ownership import is_applied
from rigel_k8s.release.plan import prunes
from rigel_k8s.release.run import Run
from rigel_k8s.release.survey import belongs, namespace_ref
from rigel_k8s.release.types import DeployOptions, Desired, InventoryItem, Plan, ReleaseId

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


def down(cluster: Cluster, release: ReleaseId, options: DeployOptions, *, volumes: bool) -> Plan:
    """Delete a release's objects and its history; its namespace stays.

    Args:
        options: `timeout` limits the end of the pods.
        volumes: also delete claims and volumes, with their data.

    Returns:
        What was deleted and what was left; neither steps nor records if there was nothing.
    """
    if cluster.get(namespace_ref(release)) is None:
        return Plan(release, ())
    records = [record.ref for record in revisions.records(cluster, release)]
    lease = lease_ref(release)
    if cluster.get(lease) is not None:
        records.append(lease)  # of a deploy that is in progress or was killed
    if not records and not find(cluster, release):
        return Plan(release, ())
    run = Run(cluster=cluster, desired=Desired(release, ()), options=options)
    with hold(cluster, release, options) as held:
        live = find(cluster, release)
        items = [InventoryItem(ref, there["metadata"]["uid"]) for ref, there in live.items()]
        steps = tuple(prunes(items, live, (), release, volumes=volumes))
        applier = Applier(
            run,
            confirm=held.confirm,
            state=f"interrupted while {release.name} was being deleted: some of it is deleted",
            way_out="run the same command again to delete the rest",
        )
        applier.prune(steps)
        pruned = [step for step in steps if step.action == "prune"]
        applier.wait_until_no_pods(pruned)
        # A deploy right after this must not meet the old data.
        applier.wait_until_gone([step.ref for step in pruned if step.ref.kind in CLAIMS])
        held.confirm()
        revisions.forget(cluster, revisions.records(cluster, release))
    return Plan(release, steps, tuple(records))


def find(cluster: Cluster, release: ReleaseId) -> Mapping[ObjectRef, Live]:
    """Return all that exists of a release."""
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

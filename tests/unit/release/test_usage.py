"""What a deploy takes of quotas and gives back: by its objects, its pods, its own record."""

from __future__ import annotations

from decimal import Decimal
from typing import Any

from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.labelling import manifests_to_apply
from rigel_k8s.release.refusals.foresight import Foreseen
from rigel_k8s.release.refusals.quotas import Change, find_excess
from rigel_k8s.release.refusals.usage import list_changes
from rigel_k8s.release.survey import Survey
from tests.support.manifests import config, desired, ref, workload

TALKER = ref("Deployment", "talker")
ROLLING = {"type": "RollingUpdate", "rollingUpdate": {"maxUnavailable": 0}}


def with_cpu(cpu: str, manifest: Manifest) -> dict[str, Any]:
    """Return a workload whose container asks for so much."""
    spec = manifest["spec"]["template"]["spec"]
    containers = [{**one, "resources": {"requests": {"cpu": cpu}}} for one in spec["containers"]]
    template = {**manifest["spec"]["template"], "spec": {**spec, "containers": containers}}
    return {**manifest, "spec": {**manifest["spec"], "template": template}}


def changes(
    *wanted: Manifest, live: tuple[Manifest, ...] = (), pods: dict[ObjectRef, Any] | None = None
) -> dict[ObjectRef, list[Change]]:
    """Return what a deploy does to quotas, by object."""
    release = desired(*wanted)
    manifests = manifests_to_apply(release)
    found = Foreseen({ref_of(m): m for m in manifests}, pods or {})
    there = {ref_of(one): one for one in live}
    survey = Survey(release, manifests, there, found, {}, [], None)
    result: dict[ObjectRef, list[Change]] = {}
    for change in list_changes(survey):
        result.setdefault(change.ref, []).append(change)
    return result


def test_new_objects_and_the_record_count() -> None:
    """The Lease too, while the deploy lasts; an object that is there counts no more."""
    found = changes(config("a"), config("b"), live=(config("b"),))
    names = {ref.name: set(change[0].added) for ref, change in found.items()}
    assert names == {
        "a": {"count/configmaps", "configmaps"},
        "rigel.demo.v1": {"count/secrets", "secrets"},
        "rigel.demo": {"count/leases.coordination.k8s.io"},
    }


def test_a_pod_counts_as_the_cluster_would_store_it() -> None:
    """A LimitRange may have filled in what it asks for; a refused one counts as it is written."""
    made = workload()
    pod = with_cpu("2", made)["spec"]["template"]
    [_, change] = changes(made, pods={TALKER: pod})[TALKER]
    assert change.added["cpu"] == 2
    [_, change] = changes(with_cpu("1", made), pods={TALKER: Forbidden("no")})[TALKER]
    assert change.added["cpu"] == 1


def test_a_predecessor_gives_back_what_it_takes() -> None:
    """A node under another name ends before its successor starts; one that stays does not."""
    old, new = workload("old", singleton="/n"), workload("new", singleton="/n")
    [_, change] = changes(new, live=(old,))[ref("Deployment", "new")]
    assert change.freed["pods"] == 1
    both = changes(new, old, live=(old,))
    assert both[ref("Deployment", "new")][1].freed == {}


def test_a_roll_out_overlaps_only_where_its_pods_change() -> None:
    """And only where the new pod comes before the old one ends."""
    rolling = workload()
    rolling["spec"]["strategy"] = ROLLING
    pod = rolling["spec"]["template"]
    [change] = changes(rolling, live=(rolling,), pods={TALKER: pod})[TALKER]
    assert (change.overlap["pods"], change.freed["pods"]) == (1, 1)
    [change] = changes(rolling, live=(rolling,))[TALKER]
    assert change.overlap == {}
    recreated = workload()
    [change] = changes(recreated, live=(recreated,), pods={TALKER: pod})[TALKER]
    assert change.overlap == {}


def test_a_quota_that_is_not_computed_yet_refuses_nothing() -> None:
    """It has no `used` until Kubernetes has counted."""
    quota = {"metadata": {"name": "new"}, "spec": {}, "status": {"hard": {"pods": "0"}}}
    assert [*find_excess([quota], [Change(TALKER, {"pods": Decimal(1)})])] == []

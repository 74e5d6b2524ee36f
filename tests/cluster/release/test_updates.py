"""Create, update, prune, roll back: what becomes of a release's objects on a real cluster."""

from __future__ import annotations

import base64
import gzip
import threading
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.difference import difference
from rigel_k8s.release.revisions import find_last_good, history
from rigel_k8s.release.types import Desired, ReleaseId
from tests.support.releases import deploy, diff, down, rollback

pytestmark = pytest.mark.cluster


def names(cluster: Any, kind: str, make: Any, version: str = "v1") -> set[str]:
    found = cluster.list(version, kind, make.namespace, labels={RELEASE_LABEL: "demo"})
    return {live["metadata"]["name"] for live in found}


def test_a_deploy_makes_what_is_wanted_and_waits_until_it_is_ready(
    cluster: Any, make: Any, report: Any
) -> None:
    """After a deploy the pods are ready and the revision is good and knows every UID."""
    wanted = make.desired(make.config(a="1"), make.deployment(), options={"x": [1]})
    revision = deploy(wanted, cluster, report=report)
    live = cluster.get(ObjectRef("apps/v1", "Deployment", make.namespace, "talker"))
    assert live["status"]["availableReplicas"] == 1
    assert (revision.number, revision.status) == (1, "good")
    assert all(item.uid for item in revision.inventory)
    assert find_last_good(cluster, make.release).options == {"x": [1]}
    assert ("talker", "1 of 1 ready", True) in report.states


def test_an_unchanged_deploy_writes_nothing(
    cluster: Any, admin: Any, make: Any, report: Any
) -> None:
    """The same release again: no object, no revision and no Lease is written."""
    wanted = make.desired(make.config(a="1"), make.secret(p="x"), make.deployment())
    first = deploy(wanted, cluster, report=report)
    before = versions(admin, make)
    assert deploy(wanted, cluster, report=report) == first
    assert versions(admin, make) == before


def versions(cluster: Any, make: Any) -> dict[tuple[str, str], str]:
    kinds = [("v1", "ConfigMap"), ("v1", "Secret"), ("apps/v1", "Deployment")]
    kinds.append(("coordination.k8s.io/v1", "Lease"))
    return {
        (kind, live["metadata"]["name"]): live["metadata"]["resourceVersion"]
        for version, kind in kinds
        for live in cluster.list(version, kind, make.namespace)
        if live["metadata"]["name"] != "kube-root-ca.crt"
    }


def test_an_update_changes_prunes_and_leaves_the_rest_alone(
    cluster: Any, make: Any, report: Any
) -> None:
    """What is not wanted any more goes, what is unchanged keeps its pods."""
    one = make.desired(make.config("a", k="1"), make.config("b", k="1"), make.deployment())
    deploy(one, cluster, report=report)
    ref = ObjectRef("apps/v1", "Deployment", make.namespace, "talker")
    before = cluster.get(ref)["metadata"]
    two = make.desired(make.config("a", k="2"), make.deployment())
    plan = diff(two, cluster)
    assert {(s.action, s.ref.name) for s in plan.changes} == {("change", "a"), ("prune", "b")}
    assert "-  k: '1'\n+  k: '2'" in difference(plan.steps)
    revision = deploy(two, cluster, report=report)
    assert names(cluster, "ConfigMap", make) == {"a"}
    assert cluster.get(ref)["metadata"]["generation"] == before["generation"]
    assert {item.ref.name for item in revision.inventory} == {"a", "talker"}


def test_a_diff_writes_nothing(cluster: Any, admin: Any, make: Any, report: Any) -> None:
    """A diff of a first deploy shows everything and leaves the cluster as it was."""
    before = versions(admin, make)
    plan = diff(make.desired(make.config(a="1"), make.secret(p="hunter2")), cluster)
    assert [step.action for step in plan.steps] == ["create", "create"]
    assert "hunter2" not in difference(plan.steps)
    assert versions(admin, make) == before


def test_a_field_that_the_rigelfile_drops_is_gone(cluster: Any, make: Any, report: Any) -> None:
    """Server-side apply removes what an earlier revision said and this one does not."""
    deploy(make.desired(make.config(a="1", b="2")), cluster, report=report)
    deploy(make.desired(make.config(a="1")), cluster, report=report)
    live = cluster.get(ObjectRef("v1", "ConfigMap", make.namespace, "config"))
    assert live["data"] == {"a": "1"}


def test_a_rollback_is_a_deploy_of_the_older_objects(cluster: Any, make: Any, report: Any) -> None:
    """A rollback brings back what was pruned and changed; Secrets that are there stay."""
    secret = make.secret(p="x")
    deploy(make.desired(make.config("a", k="1"), make.config("b"), secret), cluster, report=report)
    deploy(make.desired(make.config("a", k="2"), secret), cluster, report=report)
    revision = rollback(cluster, make.release, report=report)
    assert revision.number == 3
    assert revision.description == "rollback to revision 1"
    assert names(cluster, "ConfigMap", make) == {"a", "b"}
    assert names(cluster, "Secret", make) == {"secret"}
    live = cluster.get(ObjectRef("v1", "ConfigMap", make.namespace, "a"))
    assert live["data"] == {"k": "1"}
    statuses = [r.status for r in history(cluster, make.release)]
    assert statuses == ["superseded", "superseded", "good"]
    with pytest.raises(UserError, match="no revision 9"):
        rollback(cluster, make.release, 9, report=report)


def test_history_is_limited_and_holds_no_secret(cluster: Any, make: Any, report: Any) -> None:
    """Ten revisions are kept; the data of Secrets stand in none of them."""
    for number in range(12):
        wanted = make.desired(make.config(k=str(number)), make.secret(p="hunter2"))
        deploy(wanted, cluster, report=report)
    kept = history(cluster, make.release)
    assert [revision.number for revision in kept] == list(range(3, 13))
    for secret in cluster.list("v1", "Secret", make.namespace):
        if secret["type"] == "rigel-k8s/release.v1":
            text = gzip.decompress(base64.b64decode(secret["data"]["release"])).decode()
            assert "hunter2" not in text
            assert base64.b64encode(b"hunter2").decode() not in text


def test_a_missing_namespace_is_part_of_the_plan(admin: Any, make: Any, report: Any) -> None:
    """A namespace that the Rigelfile names is created; another one is asked for."""
    release = ReleaseId(f"{make.namespace}-new", "demo")
    config = make.config(a="1")
    config["metadata"]["namespace"] = release.namespace
    ref = ObjectRef("v1", "Namespace", "", release.namespace)
    with pytest.raises(ClusterError, match="there is no namespace") as caught:
        deploy(Desired(release, (config,)), admin, report=report)
    assert "kubectl create namespace" in (caught.value.hint or "")
    wanted = Desired(release, (config,), create_namespace=True)
    assert [s.ref.kind for s in diff(wanted, admin).steps] == ["Namespace", "ConfigMap"]
    assert admin.get(ref) is None
    try:
        deploy(wanted, admin, report=report)
        down(admin, release, volumes=True, report=report)
        assert admin.get(ref) is not None, "down leaves the namespace"
    finally:
        admin.delete(ref)


def test_a_kind_and_an_object_of_it_come_in_one_deploy(admin: Any, make: Any, report: Any) -> None:
    """A CustomResourceDefinition is served before the objects that need it are applied."""
    group = f"{make.namespace}.example.com"
    schema = {"type": "object", "x-kubernetes-preserve-unknown-fields": True}
    definition = {
        "apiVersion": "apiextensions.k8s.io/v1",
        "kind": "CustomResourceDefinition",
        "metadata": {"name": f"robots.{group}"},
        "spec": {
            "group": group,
            "scope": "Namespaced",
            "names": {"plural": "robots", "singular": "robot", "kind": "Robot"},
            "versions": [
                {
                    "name": "v1",
                    "served": True,
                    "storage": True,
                    "schema": {"openAPIV3Schema": schema},
                }
            ],
        },
    }
    robot = {
        "apiVersion": f"{group}/v1",
        "kind": "Robot",
        "metadata": {"name": "r2", "namespace": make.namespace},
        "spec": {"legs": 3},
    }
    ref = ObjectRef(f"{group}/v1", "Robot", make.namespace, "r2")
    deploy(make.desired(definition, robot), admin, report=report)
    assert admin.get(ref)["spec"] == {"legs": 3}
    down(admin, make.release, volumes=True, report=report)
    assert admin.get(ref) is None


def test_a_ros_name_moves_without_two_pods_at_once(cluster: Any, make: Any, report: Any) -> None:
    """Where a singleton's object changes its name, the old pod is gone before the new one is."""
    slow = "trap 'sleep 1; exit 0' TERM; while true; do sleep 0.1; done"
    pod = {"terminationGracePeriodSeconds": 5}
    old = make.deployment("old", slow, singleton="/talker", pod=pod)
    deploy(make.desired(old), cluster, report=report)
    together: list[set[str]] = []
    over = threading.Event()
    watcher = threading.Thread(target=record_pods, args=(cluster, make, together, over))
    watcher.start()
    try:
        new = make.deployment("new", slow, singleton="/talker", pod=pod)
        deploy(make.desired(new), cluster, report=report)
    finally:
        over.set()
        watcher.join()
    seen = set().union(*together)
    assert any(name.startswith("new-") for name in seen)
    assert any(name.startswith("old-") for name in seen)
    assert max(len(pods) for pods in together) == 1


def record_pods(cluster: Any, make: Any, together: list[set[str]], over: threading.Event) -> None:
    there: set[str] = set()
    labels = {"test/singleton": "talker"}
    for event in cluster.watch("v1", "Pod", make.namespace, labels=labels, cancel=over):
        name = event.object["metadata"]["name"]
        there = there - {name} if event.type == "DELETED" else there | {name}
        together.append(there)


def test_what_changes_on_the_cluster_is_put_right(cluster: Any, make: Any, report: Any) -> None:
    """An object that somebody deleted is made again, though the Rigelfile has not changed."""
    wanted = make.desired(make.config(a="1"))
    deploy(wanted, cluster, report=report)
    ref = ObjectRef("v1", "ConfigMap", make.namespace, "config")
    cluster.delete(ref)
    assert [step.action for step in diff(wanted, cluster).steps] == ["create"]
    deploy(wanted, cluster, report=report)
    assert cluster.get(ref)["data"] == {"a": "1"}

"""Update, prune, move: what becomes of a release's objects on a real cluster."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.difference import difference
from tests.support.releases import deploy, diff, down

pytestmark = pytest.mark.cluster


def names(cluster: Any, kind: str, make: Any, version: str = "v1") -> set[str]:
    found = cluster.list(version, kind, make.namespace, labels={RELEASE_LABEL: "demo"})
    return {live["metadata"]["name"] for live in found}


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

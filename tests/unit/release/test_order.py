"""What comes before what: masters before nodes, ends before beginnings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release import apply
from rigel_k8s.release import types as order
from tests.support.controllers import Controllers, is_ready
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import NAME, RELEASE, claim, config, desired, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, down

MASTER = workload("ros-master", first=True)
#: Whether a pod is ready, by its workload.
Pods = dict[str, bool]


def pods(fake: FakeCluster) -> Pods:
    """Return the pods that there are, those that are ending too."""
    return {
        live["metadata"]["labels"][NAME]: is_ready(live)
        for ref, live in fake.objects.items()
        if ref.kind == "Pod"
    }


@pytest.fixture
def seen(fake: FakeCluster) -> Callable[[str, str], Pods]:
    """The pods that were there when a workload was first written: seen("apply", "talker")."""
    moments: dict[tuple[str, str], Pods] = {}

    def before(verb: str, ref: ObjectRef) -> None:
        if ref.kind in ("Deployment", "PersistentVolumeClaim", "Service"):
            moments.setdefault((verb, ref.name), pods(fake))

    def look(verb: str, name: str) -> Pods:
        return moments[verb, name]

    fake.store.before = before
    return look


def slow(fake: FakeCluster, **ending: int) -> None:
    """Let the pods of some workloads take long to end."""
    fake.store.controllers = Controllers(ending=ending)


def test_what_is_bound_and_used_is_applied_before() -> None:
    """Objects of one wave are applied side by side, in any order."""
    kinds = ("CustomResourceDefinition", "Role", "RoleBinding", "Deployment")
    waves = [order.wave(kind) for kind in kinds]
    assert waves == sorted(set(waves))


def test_nodes_are_applied_when_their_master_is_ready(
    fake: FakeCluster, report: Any, seen: Any
) -> None:
    """A node that finds no master ends, and one that finds an old one is lost to the new."""
    deploy(desired(workload("a-node"), MASTER, config()), fake, report=report)
    assert seen("apply", "ros-master") == {}
    assert seen("apply", "a-node") == {"ros-master": True}


def test_a_changed_master_is_ready_before_changed_nodes(
    fake: FakeCluster, report: Any, seen: Any
) -> None:
    deploy(desired(workload("a-node"), MASTER), fake, report=report)
    new = workload("ros-master", "app:2", first=True)
    fake.store.before = lambda verb, ref: None
    moments: list[list[str]] = []

    def before(verb: str, ref: ObjectRef) -> None:
        if (verb, ref.name) == ("apply", "a-node"):
            masters = [
                live["spec"]["containers"][0]["image"]
                for ref, live in fake.objects.items()
                if ref.kind == "Pod" and "master" in ref.name and is_ready(live)
            ]
            moments.append(masters)

    fake.store.before = before
    deploy(desired(workload("a-node", "app:2"), new), fake, report=report)
    assert moments == [["app:2"]]


def test_the_old_pod_of_a_ros_name_ends_before_its_successor_starts(
    fake: FakeCluster, report: Any, seen: Any
) -> None:
    """Two nodes of one ROS 1 name would throw each other out; another name is in no one's way."""
    before = workload("old", singleton="/talker"), workload("other", singleton="/other")
    deploy(desired(*before), fake, report=report)
    slow(fake, old=20)
    deploy(desired(workload("new", singleton="/talker")), fake, report=report)
    assert seen("delete", "old") == {"old": True, "other": True}
    assert seen("apply", "new") == {"other": True}


def test_other_workloads_go_when_the_new_are_ready(
    fake: FakeCluster, report: Any, seen: Any
) -> None:
    """What runs goes on until there is something better."""
    deploy(desired(workload("old")), fake, report=report)
    deploy(desired(workload("new")), fake, report=report)
    assert seen("apply", "new") == {"old": True}
    assert seen("delete", "old") == {"old": True, "new": True}


def test_down_shows_what_is_still_deleted(fake: FakeCluster, report: Any) -> None:
    """Each workload once, until it has no pod, and what holds data."""
    deploy(desired(MASTER, workload("a"), workload("b"), claim(), config()), fake, report=report)
    fake.objects[ref_of(claim())]["metadata"]["finalizers"] = ["kubernetes.io/pvc-protection"]
    slow(fake, a=20, b=3)

    class Releasing(Recorder):
        def progress(self, key: str, state: str, *, done: bool = False) -> None:
            super().progress(key, state, done=done)
            if (key, state) == ("data", "is being deleted"):
                fake.patch(ref_of(claim()), {"metadata": {"finalizers": []}})

    report = Releasing()
    down(fake, RELEASE, volumes=True, report=report)
    states = (("is being deleted", False), ("deleted", True))
    shown = ("a", "b", "ros-master", "data")
    assert report.states == [(name, *state) for name in shown for state in states]


@pytest.mark.parametrize("how", ["down", "deploy"])
def test_a_master_goes_when_its_nodes_are_gone(
    fake: FakeCluster, report: Any, seen: Any, how: str
) -> None:
    """A node takes leave of its master, and hangs where nobody answers."""
    address = {"apiVersion": "v1", "kind": "Service", "spec": {}}
    address["metadata"] = {"name": "address", "namespace": "n"}
    wanted = desired(MASTER, address, workload("a-node"), workload("z-node"))
    deploy(wanted, fake, report=report)
    slow(fake, **{"a-node": 20, "z-node": 5})
    if how == "down":
        down(fake, RELEASE, volumes=False, report=report)
    else:
        deploy(desired(config()), fake, report=report)
    assert set(seen("delete", "a-node")) == {"a-node", "z-node", "ros-master"}
    assert set(seen("delete", "ros-master")) == {"ros-master"}
    assert set(seen("delete", "address")) <= {"ros-master"}, "its Service"


def test_data_go_when_nothing_uses_them(fake: FakeCluster, report: Any, seen: Any) -> None:
    deploy(desired(MASTER, workload("a"), claim()), fake, report=report)
    slow(fake, **{"a": 20, "ros-master": 20})
    down(fake, RELEASE, volumes=True, report=report)
    assert seen("delete", "data") == {}


def test_pods_that_do_not_end_are_named(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A node that is away keeps its pod for ever."""
    monkeypatch.setattr(apply, "SLICE", 0.05)
    deploy(desired(workload("a")), fake, report=report)
    slow(fake, a=10**9)
    with pytest.raises(ClusterError, match=r"pods of Deployment n/a did not end within 0.1 s: a-"):
        down(fake, RELEASE, volumes=False, report=report, timeout=0.1)

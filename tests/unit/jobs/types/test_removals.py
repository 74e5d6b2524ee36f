"""What a removal refuses, and what it leaves: others' networks in use, data and what opens them."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import UserError
from rigel_k8s.network.options import Install
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.names import RELEASE as STACK
from rigel_k8s.release.types import DeployOptions, Desired, ReleaseId
from rigel_multus import removal as network_removal
from rigel_multus.removal import users
from rigel_stack import removal as observability_removal
from rigel_stack.password import ADMIN_SECRET, ensure_administrator
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder
from tests.support.releases import deploy

MULTUS = "k8s.v1.cni.cncf.io/networks"


def namespace(name: str) -> dict[str, Any]:
    return {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": name}}


def remove_stack(cluster: Any, report: Recorder, *, volumes: bool) -> None:
    options = DeployOptions(report=report)
    observability_removal.remove(cluster, options, volumes=volumes, namespace="monitoring")


@pytest.fixture
def machine(fake: FakeCluster) -> FakeCluster:
    """A cluster of one machine, with Multus."""
    fake.store.controllers = None
    fake.create(namespace("kube-system"))
    ready = {"conditions": [{"type": "Ready", "status": "True"}]}
    labels = {"kubernetes.io/os": "linux"}
    info = {"kubeletVersion": "v1.34.4"}
    fake.create(
        {
            "apiVersion": "v1",
            "kind": "Node",
            "metadata": {"name": "robot", "labels": labels},
            "status": {**ready, "nodeInfo": info},
        }
    )
    return fake


def multus(fake: FakeCluster, *, ours: bool) -> None:
    spec = {
        "containers": [{"name": "multus", "image": "x/multus-cni:1"}],
        "volumes": [{"name": "cni", "hostPath": {"path": "/etc/cni/net.d"}}],
    }
    labels = {"rigel-k8s/release": "rigel-network"} if ours else {}
    name = "rigel-multus" if ours else "kube-multus-ds"
    fake.create(
        {
            "apiVersion": "apps/v1",
            "kind": "DaemonSet",
            "metadata": {"name": name, "namespace": "kube-system", "labels": labels},
            "spec": {"template": {"spec": spec}},
        }
    )


def pod(name: str, networks: str = "", **rest: Any) -> dict[str, Any]:
    notes = {MULTUS: networks} if networks else {}
    meta = {"name": name, "namespace": "n", "annotations": notes}
    return {"apiVersion": "v1", "kind": "Pod", "metadata": meta, "spec": {}, **rest}


def test_multus_is_not_removed_while_pods_are_attached(
    machine: FakeCluster, report: Recorder
) -> None:
    """They would keep their interface, and no pod after them would get one."""
    multus(machine, ours=True)
    machine.create(pod("arm", "lan"))
    machine.calls.clear()
    with pytest.raises(UserError, match="nothing was removed") as caught:
        network_removal.remove(machine, Install(), DeployOptions(report=report))  # type: ignore[arg-type]
    assert caught.value.details == ("pod n/arm has a second network",)
    assert machine.writes == []


def test_multus_of_others_is_never_removed(machine: FakeCluster, report: Recorder) -> None:
    """Not even by force."""
    multus(machine, ours=False)
    machine.calls.clear()
    for force in (False, True):
        with pytest.raises(UserError, match="was not installed by rigel"):
            network_removal.remove(machine, Install(), DeployOptions(report=report), force=force)  # type: ignore[arg-type]
    assert machine.writes == []


def test_multus_is_not_removed_while_a_machine_is_away(
    machine: FakeCluster, report: Recorder
) -> None:
    """It would come back with a configuration that leads nowhere, and start no pod."""
    multus(machine, ours=True)
    away = {"conditions": [{"type": "Ready", "status": "Unknown"}]}
    machine.store.objects[ObjectRef("v1", "Node", "", "robot")]["status"] |= away
    with pytest.raises(UserError, match="nothing was removed") as caught:
        network_removal.remove(machine, Install(), DeployOptions(report=report))  # type: ignore[arg-type]
    assert caught.value.details == ("machine robot is unreachable and keeps Multus' configuration",)


def test_who_uses_a_second_network(machine: FakeCluster) -> None:
    """A pod that is over does not, nor does one of the machine's own network."""
    machine.create(pod("arm", "lan"))
    machine.create(pod("plain"))
    machine.create(pod("done", "lan", status={"phase": "Succeeded"}))
    machine.create(pod("broken", "lan", status={"phase": "Failed"}))
    host = pod("host", "lan")
    host["spec"] = {"hostNetwork": True}
    machine.create(host)
    assert [live["metadata"]["name"] for live in users(machine)] == ["arm"]  # type: ignore[arg-type]


@pytest.fixture
def stack(fake: FakeCluster, report: Recorder) -> FakeCluster:
    """A small stack with data and a password."""
    fake.create(namespace("monitoring"))
    meta = {"namespace": "monitoring"}
    config = {"apiVersion": "v1", "kind": "ConfigMap", "metadata": {**meta, "name": "loki"}}
    claim = {"apiVersion": "v1", "kind": "PersistentVolumeClaim", "spec": {}}
    claim["metadata"] = {**meta, "name": "data"}
    ensure_administrator(fake, "monitoring", None)  # type: ignore[arg-type]
    deploy(Desired(ReleaseId("monitoring", STACK), (config, claim)), fake, report=report)  # type: ignore[arg-type]
    return fake


SECRET = ObjectRef("v1", "Secret", "monitoring", ADMIN_SECRET)


@pytest.mark.parametrize("volumes", [False, True])
def test_grafanas_password_stays_or_goes_with_the_data(
    stack: FakeCluster, report: Recorder, *, volumes: bool
) -> None:
    """Data that nobody can open are lost."""
    remove_stack(stack, report, volumes=volumes)
    assert stack.names("ConfigMap", "PersistentVolumeClaim") == (set() if volumes else {"data"})
    assert (SECRET in stack.objects) is not volumes


def test_the_collector_ends_before_what_takes_its_lines(
    fake: FakeCluster, report: Recorder
) -> None:
    """The last lines of a robot are those that somebody will look for."""
    fake.create(namespace("monitoring"))
    here = ReleaseId("monitoring", STACK)
    objects = []
    for kind, name in (("Deployment", "loki"), ("DaemonSet", "promtail")):
        labels = {"app.kubernetes.io/name": name}
        template = {"metadata": {"labels": labels}, "spec": {"containers": []}}
        spec = {"selector": {"matchLabels": labels}, "template": template, "replicas": 0}
        meta = {"name": name, "namespace": "monitoring"}
        objects.append({"apiVersion": "apps/v1", "kind": kind, "metadata": meta, "spec": spec})
    deploy(Desired(here, tuple(objects)), fake, report=report)  # type: ignore[arg-type]
    fake.calls.clear()
    remove_stack(fake, report, volumes=False)
    names = [ref.name for _, ref in fake.writes if isinstance(ref, ObjectRef)]
    assert names[:2] == ["promtail", f"rigel.{STACK}"], "before the removal has its Lease"
    assert fake.names("Deployment", "DaemonSet") == set()


def test_a_stack_that_is_not_there_is_told(fake: FakeCluster, report: Recorder) -> None:
    with pytest.raises(UserError, match="there is no observability stack"):
        remove_stack(fake, report, volumes=False)

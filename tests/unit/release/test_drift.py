"""What others add to our objects: named, left there, and removed by --adopt."""

from __future__ import annotations

from typing import Any

import click
import pytest

from rigel_k8s.cli.status import status_text
from rigel_k8s.commands.status import Status
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.release.drift import describe_drift
from rigel_k8s.release.look import look_at
from rigel_k8s.release.part import Part
from rigel_k8s.release.status import status
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired, ref, workload
from tests.support.releases import deploy, diff

TALKER = ref("Deployment", "talker")


def anonymous() -> dict[str, Any]:
    """Return the Deployment of a node without a number of pods: others may set it."""
    made = workload()
    del made["spec"]["replicas"]
    return made


def set_env(fake: FakeCluster, name: str, value: str) -> None:
    """Do as `kubectl set env`."""
    live = fake.objects[TALKER]
    [container] = live["spec"]["template"]["spec"]["containers"]
    env = [e for e in container.get("env", ()) if e["name"] != name]
    changed = {**container, "env": [*env, {"name": name, "value": value}]}
    body = {"spec": {"template": {"spec": {"containers": [changed]}}}}
    fake.as_manager("kubectl-set").patch(TALKER, body)


def warn(fake: FakeCluster, report: Any, wanted: Any) -> list[str]:
    look = look_at(Part(desired=wanted), fake, adopt=False)
    assert look.plan.changes == ()
    return list(look.warnings)


def test_what_others_add_is_named(fake: FakeCluster, report: Any) -> None:
    """An item of a list, a count of pods; by whom. Nothing is written, nothing is tried."""
    wanted = desired(anonymous(), config(k="1"))
    deploy(wanted, fake, report=report)
    set_env(fake, "FOO", "bar")
    fake.as_manager("kubectl-patch").patch(TALKER, {"spec": {"replicas": 2}})
    fake.as_manager("kubectl-edit").patch(ref("ConfigMap", "c"), {"data": {"more": "2"}})
    fake.calls.clear()
    assert warn(fake, report, wanted) == [
        "ConfigMap c was changed by kubectl-edit: data more; --adopt undoes it",
        "Deployment talker was changed by kubectl-set: env FOO; --adopt undoes it",
        "Deployment talker was changed by kubectl-patch: replicas 2; --adopt undoes it",
    ]
    assert {verb for verb, _ in fake.calls} <= {"get", "list"}


def test_our_own_patches_are_no_drift(fake: FakeCluster, report: Any) -> None:
    """`rigel network install` lets machines be away in this way."""
    wanted = desired(anonymous(), config(k="1"))
    deploy(wanted, fake, report=report)
    fake.patch(TALKER, {"spec": {"revisionHistoryLimit": 3}})
    assert warn(fake, report, wanted) == []


def test_adopt_removes_what_others_have_added(fake: FakeCluster, report: Any) -> None:
    """What `diff --adopt` shows; then nothing is left to do."""
    wanted = desired(anonymous(), config(k="1"))
    deploy(wanted, fake, report=report)
    set_env(fake, "FOO", "bar")
    fake.as_manager("kubectl-patch").patch(TALKER, {"spec": {"replicas": 2}})
    [step] = diff(wanted, fake, adopt=True).changes
    assert step.result is not None
    assert "env" not in step.result["spec"]["template"]["spec"]["containers"][0]
    deploy(wanted, fake, report=report, adopt=True)
    live = fake.objects[TALKER]
    assert "env" not in live["spec"]["template"]["spec"]["containers"][0]
    assert live["spec"]["replicas"] == 1
    assert describe_drift(live) == []
    assert diff(wanted, fake, adopt=True).changes == ()


def test_a_scale_of_a_named_node_is_a_change_in_the_plan(fake: FakeCluster, report: Any) -> None:
    """The number has no owner any more: it is shown as ours to write, and put back."""
    wanted = desired(workload(replicas=1))
    deploy(wanted, fake, report=report)
    fake.as_manager("kubectl").scale(TALKER, 2)
    [step] = diff(wanted, fake).changes
    assert (step.action, step.ref) == ("change", TALKER)
    deploy(wanted, fake, report=report)
    assert fake.objects[TALKER]["spec"]["replicas"] == 1


@pytest.mark.parametrize("manager", ["kube-controller-manager", "k3s"])
def test_what_kubernetes_writes_is_no_drift(fake: FakeCluster, report: Any, manager: str) -> None:
    """An autoscaler of an anonymous node; --adopt leaves it alone, too."""
    deploy(desired(anonymous()), fake, report=report)
    fake.as_manager(manager).patch(TALKER, {"spec": {"replicas": 3}})
    assert warn(fake, report, desired(anonymous())) == []
    deploy(desired(anonymous()), fake, report=report, adopt=True)
    assert fake.objects[TALKER]["spec"]["replicas"] == 3


def test_the_memory_of_the_gate_is_no_drift(fake: FakeCluster, report: Any) -> None:
    """It is not named, and --adopt leaves it alone, also where the Secret itself changes."""
    there = ref("Secret", "ros-master-memory")
    meta = {"name": there.name, "namespace": there.namespace}
    memory = {"apiVersion": "v1", "kind": "Secret", "metadata": meta}
    deploy(desired(memory), fake, report=report)
    fake.as_manager("rigel-gate").patch(there, {"data": {"memory": "eA=="}})
    assert warn(fake, report, desired(memory)) == []
    for wanted in (memory, {**memory, "metadata": {**meta, "labels": {"team": "a"}}}):
        deploy(desired(wanted), fake, report=report, adopt=True)
        assert fake.objects[there]["data"] == {"memory": "eA=="}


def test_notes_and_restarts_are_no_drift(fake: FakeCluster, report: Any) -> None:
    """Labels and annotations change nothing that runs; a restart is not a change."""
    deploy(desired(anonymous()), fake, report=report)
    note = {"annotations": {"kubectl.kubernetes.io/restartedAt": "2026-11-24T22:00:00Z"}}
    body = {"metadata": {"labels": {"team": "a"}}, "spec": {"template": {"metadata": note}}}
    fake.as_manager("kubectl-rollout").patch(TALKER, body)
    assert describe_drift(fake.objects[TALKER]) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"replicas": 0}, "someone has scaled it to 0 pods"),
        ({"paused": True}, "someone has paused its roll-outs"),
    ],
)
def test_what_someone_has_stopped_is_not_ready(
    fake: FakeCluster, report: Any, change: dict[str, Any], words: str
) -> None:
    """In `status`, whose exit code says it; a deploy puts it right."""
    wanted = desired(workload(replicas=1), workload("other"))
    deploy(wanted, fake, report=report)
    if "replicas" in change:
        fake.as_manager("kubectl").scale(TALKER, 0)
    else:
        fake.as_manager("kubectl").patch(TALKER, {"spec": change})
    fake.settle()
    talker = next(one for one in status(fake, RELEASE).workloads if one.name == "talker")
    assert words in talker.message
    assert not talker.ok

    deploy(wanted, fake, report=report, adopt=True)
    assert all(one.ok for one in status(fake, RELEASE).workloads)


def test_what_the_rigelfile_stops_is_as_it_is_to_be(fake: FakeCluster, report: Any) -> None:
    """A node with `replicas: 0`."""
    deploy(desired(workload(replicas=0)), fake, report=report)
    assert all(one.ok for one in status(fake, RELEASE).workloads)


SERVICE: dict[str, Any] = {
    "apiVersion": "v1",
    "kind": "Service",
    "metadata": {"name": "talker", "namespace": "n"},
    "spec": {"clusterIP": "None", "selector": {"app": "talker"}, "ports": [{"port": 80}]},
}


@pytest.mark.parametrize("kind", ["Deployment", "Service", "ConfigMap"])
def test_what_someone_has_deleted_is_missing(fake: FakeCluster, report: Any, kind: str) -> None:
    """In `status`, whose exit code says it; a deploy makes it again."""
    wanted = desired(workload(), SERVICE, config("talker"), workload("other"))
    deploy(wanted, fake, report=report)
    assert status(fake, RELEASE).ok
    fake.delete(ref(kind, "talker"))
    fake.settle()
    found = status(fake, RELEASE)
    line = f"{kind} talker is missing: someone has deleted it; `rigel run` makes it again"
    assert (found.missing, found.ok) == ((line,), False)
    assert line in click.unstyle(status_text(Status(found)))
    assert "of 2 ready" not in status_text(Status(found))

    deploy(wanted, fake, report=report)
    assert status(fake, RELEASE).ok


def test_without_the_right_to_see_services_none_is_missing(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A viewer's case."""
    deploy(desired(workload(), SERVICE), fake, report=report)
    plain = FakeCluster.list

    def list_(self: Any, api_version: str, kind: str, *words: Any, **more: Any) -> Any:
        if kind == "Service":
            raise Forbidden("no")
        return plain(self, api_version, kind, *words, **more)

    monkeypatch.setattr(FakeCluster, "list", list_)
    assert status(fake, RELEASE).ok

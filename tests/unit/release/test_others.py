"""What others own or have changed: named, refused, adopted only when asked for."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import ConflictError
from rigel_k8s.release.apply import Applier
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import config, desired, ref, workload
from tests.support.releases import deploy, diff, make_run


def test_fields_of_another_manager_are_refused(fake: FakeCluster, report: Any) -> None:
    """By name, before anything is written; --adopt takes them."""
    deploy(desired(config("a", k="1"), config("b", k="1")), fake, report=report)
    fake.as_manager("argo").apply(config("b", k="theirs"), force=True)
    fake.calls.clear()
    wanted = desired(config("a", k="2"), config("b", k="2"))
    with pytest.raises(ConflictError, match="nothing was changed") as caught:
        deploy(wanted, fake, report=report)
    assert caught.value.details == ("ConfigMap n/b: argo owns .data.k",)
    assert "--adopt" in (caught.value.hint or "")
    assert fake.writes == []
    deploy(wanted, fake, report=report, adopt=True)
    assert fake.objects[ref("ConfigMap", "b")]["data"] == {"k": "2"}


def test_an_edit_is_seen_though_the_rigelfile_has_not_changed(
    fake: FakeCluster, report: Any
) -> None:
    """The hash is still ours: ownership tells."""
    wanted = desired(config(k="1"))
    deploy(wanted, fake, report=report)
    fake.as_manager("kubectl-edit").patch(ref("ConfigMap", "c"), {"data": {"k": "edited"}})
    with pytest.raises(ConflictError) as caught:
        diff(wanted, fake)
    assert caught.value.details == ("ConfigMap n/c: kubectl-edit owns .data.k",)
    deploy(wanted, fake, report=report, adopt=True)
    assert fake.objects[ref("ConfigMap", "c")]["data"] == {"k": "1"}


@pytest.mark.parametrize("operation", ["apply", "create"])
def test_what_is_adopted_becomes_what_the_rigelfile_says(
    fake: FakeCluster, report: Any, operation: str
) -> None:
    """What the other tool had set besides goes away."""
    getattr(fake.as_manager("kubectl"), operation)(config(k="1", extra="theirs"))
    wanted = desired(config(k="1"))
    with pytest.raises(ConflictError) as caught:
        deploy(wanted, fake, report=report)
    assert caught.value.details == ("ConfigMap n/c already exists, made by kubectl",)
    deploy(wanted, fake, report=report, adopt=True)
    assert fake.objects[ref("ConfigMap", "c")]["data"] == {"k": "1"}
    assert diff(wanted, fake).changes == ()


def test_who_deploys_is_told_of_what_is_in_development(fake: FakeCluster, report: Any) -> None:
    """Its developer is told as well, by their own command."""
    wanted = desired(workload("talker"), workload("listener"))
    deploy(wanted, fake, report=report)
    note = "talker is in development by ann@laptop since 10:00"
    body = {"metadata": {"annotations": {"rigel-k8s/development": note}}, "spec": {"replicas": 0}}
    fake.as_manager("rigel").patch(ref("Deployment", "talker"), body)
    deploy(wanted, fake, report=report, adopt=True)
    assert f"{note}; this deploy ends that" in report.warnings


def test_who_owns_what_is_read_again_where_it_changed_meanwhile(
    fake: FakeCluster, report: Any
) -> None:
    """Controllers write at any time: adopting meets a newer version, and goes on."""
    fake.as_manager("kubectl").create(config(k="1", extra="theirs"))
    plan = diff(desired(config(k="1")), fake, adopt=True)
    fake.as_manager("kubectl").patch(ref("ConfigMap", "c"), {"data": {"more": "theirs"}})
    Applier(make_run(desired(), fake, report=report, adopt=True)).apply(plan)
    assert fake.objects[ref("ConfigMap", "c")]["data"] == {"k": "1"}


def test_an_object_made_anew_after_the_plan_is_not_pruned(fake: FakeCluster, report: Any) -> None:
    """The very object that the plan saw is deleted, by its UID."""
    deploy(desired(config("a"), config("b")), fake, report=report)
    plan = diff(desired(config("a")), fake)
    fake.delete(ref("ConfigMap", "b"))
    fake.as_manager("argo").create(config("b", theirs="1"))
    Applier(make_run(desired(), fake, report=report)).prune(plan.steps)
    assert fake.objects[ref("ConfigMap", "b")]["data"] == {"theirs": "1"}
    (warning,) = report.warnings
    assert warning == "ConfigMap n/b was replaced by another program meanwhile: left alone"


def test_an_object_made_anew_before_the_plan_is_not_pruned(fake: FakeCluster, report: Any) -> None:
    deploy(desired(config("a"), config("b")), fake, report=report)
    fake.delete(ref("ConfigMap", "b"))
    fake.as_manager("argo").create(config("b", theirs="1"))
    deploy(desired(config("a")), fake, report=report)
    assert fake.objects[ref("ConfigMap", "b")]["data"] == {"theirs": "1"}


def test_a_rolling_deployment_becomes_a_recreate_one(fake: FakeCluster, report: Any) -> None:
    """What Kubernetes had filled in of the old strategy is refused beside the new one."""
    rolling = workload()
    del rolling["spec"]["strategy"]
    fake.as_manager("kubectl").create(rolling)
    deploy(desired(workload()), fake, report=report, adopt=True)
    live = fake.objects[ref("Deployment", "talker")]
    assert live["spec"]["strategy"] == {"type": "Recreate"}
    assert not diff(desired(workload()), fake).changes

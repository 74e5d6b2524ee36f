"""The order of a deploy's requests, and what happens where the cluster says no."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import ClusterError, Interrupted, RolloutFailed, UserError
from rigel_k8s.kube.failures import Forbidden, Refusal
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import revisions
from rigel_k8s.release.locking import lease_ref
from rigel_k8s.release.revisions import find_last_good, history
from rigel_k8s.release.rollout import wait
from rigel_k8s.release.types import Desired
from tests.support.controllers import unready
from tests.support.fake_cluster import FakeCluster, Killed
from tests.support.manifests import RELEASE, config, workload
from tests.support.releases import deploy, diff, rollback


def test_the_order_of_writes(fake: Any, report: Any) -> None:
    """Lease, pending revision, configuration, workloads, good revision, Lease given back."""
    deploy(Desired(RELEASE, (workload(), config("c"))), fake, report=report)
    assert [(verb, ref.name) for verb, ref in fake.writes] == [
        ("create", "rigel.demo"),
        ("create", "rigel.demo.v1"),
        ("apply", "c"),
        ("apply", "talker"),
        ("patch", "rigel.demo.v1"),
        ("delete", "rigel.demo"),
    ]


def test_a_workload_without_pods_is_not_reported(fake: Any, report: Any) -> None:
    """Such as a test: that none of its none is ready is no news. What has just ended is shown."""
    deploy(Desired(RELEASE, (workload(), workload("hears", replicas=0))), fake, report=report)
    assert {name for name, _, _ in report.states} == {"talker"}


def test_an_unchanged_deploy_costs_one_list_for_each_kind(fake: Any, report: Any) -> None:
    """And one for the revisions, the namespace and the Lease: nothing else."""
    wanted = Desired(RELEASE, (workload(), config("c"), config("d")))
    deploy(wanted, fake, report=report)
    fake.calls.clear()
    deploy(wanted, fake, report=report)
    assert sorted(verb for verb, _ in fake.calls) == ["get", "get", "list", "list", "list"]


def test_a_webhook_without_dry_run_does_not_stop_a_deploy(fake: Any, report: Any) -> None:
    """What cannot be tried is taken as it is written; an object of others is still seen."""

    def refuse(manifest: Any, dry_run: Any) -> Refusal | None:
        if not dry_run:
            return None
        error = Refusal('admission webhook "x" does not support dry run')
        error.status = 400
        return error

    fake.store.refuse = refuse
    deploy(Desired(RELEASE, (config("a", k="1"),)), fake, report=report)
    assert fake.objects[ObjectRef("v1", "ConfigMap", "n", "a")]["data"] == {"k": "1"}
    fake.as_manager("argo").create(config("theirs"))
    with pytest.raises(ClusterError, match="managed by others"):
        diff(Desired(RELEASE, (config("theirs"),)), fake)


@pytest.mark.parametrize("asked", ["list", "try"])
def test_a_right_that_only_some_objects_need_has_its_own_way_out(
    fake: Any, monkeypatch: pytest.MonkeyPatch, asked: str
) -> None:
    """Whether the objects cannot even be listed, or only not be written."""

    plain = FakeCluster.list

    def refuse(*_: Any, **more: Any) -> Any:
        raise Forbidden("you may not", hint="ask for the right")

    def list_(self: Any, api_version: str, kind: str, *words: Any, **more: Any) -> Any:
        act = refuse if kind == "ConfigMap" else plain
        return act(self, api_version, kind, *words, **more)

    wanted = Desired(RELEASE, (config("a"),), remedies={"ConfigMap": "leave it out"})
    monkeypatch.setattr(FakeCluster, *(("list", list_) if asked == "list" else ("apply", refuse)))
    for desired, hint in ((wanted, "leave it out"), (attrs.evolve(wanted, remedies={}), "ask for")):
        with pytest.raises(Forbidden) as caught:
            diff(desired, fake)
        assert hint in (caught.value.hint or "")


def test_a_namespace_that_is_being_deleted_is_told(fake: Any, report: Any) -> None:
    """Nothing can be put into it."""
    held = config("held")
    held["metadata"]["finalizers"] = ["example.com/hold"]
    fake.create(held)
    fake.delete(ObjectRef("v1", "Namespace", "", "n"))
    with pytest.raises(ClusterError, match="is being deleted") as caught:
        diff(Desired(RELEASE, (config("a"),)), fake)
    assert "kubectl wait" in (caught.value.hint or "")


def test_while_the_api_server_is_away_nothing_can_become_ready(
    fake: Any, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That time does not count as the roll-out's."""
    fake.store.controllers.kubelet = unready
    cancel = threading.Event()
    now = 0.0

    def pass_time() -> float:
        nonlocal now
        now += 1.0
        if now > 100:
            cancel.set()
        return now

    monkeypatch.setattr(wait, "time", SimpleNamespace(monotonic=pass_time))
    monkeypatch.setattr(wait, "LOOK", 0.001)
    fake.outages = lambda: now  # away from now on
    with pytest.raises(Interrupted, match="while demo was rolling out"):
        deploy(Desired(RELEASE, (workload(),)), fake, report=report, cancel=cancel, timeout=10)


def test_a_failure_marks_the_revision_and_prunes_nothing(fake: Any, report: Any) -> None:
    """What ran before stays until the new is ready; the next deploy knows all of it."""
    deploy(Desired(RELEASE, (config("old"),)), fake, report=report)
    fake.store.controllers.kubelet = unready
    with pytest.raises(RolloutFailed, match=r"1 of 1 not ready within 0\.1 s: talker"):
        deploy(Desired(RELEASE, (workload(),)), fake, report=report, timeout=0.1)
    failed = history(fake, RELEASE)[-1]
    assert failed.status == "failed"
    assert {item.ref.name for item in failed.inventory} == {"old", "talker"}
    assert ObjectRef("v1", "ConfigMap", "n", "old") in fake.objects
    good = find_last_good(fake, RELEASE)
    assert good is not None
    assert good.number == 1
    rollback(fake, RELEASE, report=report)
    names = {r.name for r in fake.objects if r.kind in ("ConfigMap", "Deployment")}
    assert names == {"old"}


def test_cancel_before_any_object_leaves_it_at_that(fake: Any, report: Any) -> None:
    """Interrupted at once: nothing of the release is applied."""
    cancel = threading.Event()
    cancel.set()
    with pytest.raises(Interrupted, match="before anything was changed"):
        deploy(Desired(RELEASE, (config("a"),)), fake, report=report, cancel=cancel)
    assert fake.writes == []


def test_a_rollback_needs_somewhere_to_go(fake: Any, report: Any) -> None:
    """The only good revision is the present one."""
    wanted = Desired(RELEASE, (config("a"),), options={"x": 1})
    deploy(wanted, fake, report=report)
    with pytest.raises(UserError, match="no good revision before the last"):
        rollback(fake, RELEASE, report=report)
    deploy(attrs.evolve(wanted, options={"x": 2}), fake, report=report)
    assert rollback(fake, RELEASE, report=report).options == {"x": 1}


def test_a_rollback_to_what_runs_says_that_nothing_changes(fake: Any, report: Any) -> None:
    """The same command twice; the first one says nothing of the kind."""
    for value in "12":
        deploy(Desired(RELEASE, (config(k=value),)), fake, report=report)
    words = "nothing to change: revision 3 is as revision 1 was"
    for said in (False, True):
        assert rollback(fake, RELEASE, 1, report=report).number == 3
        assert (words in report.lines) is said


def test_a_rollback_goes_to_the_last_good_one(fake: Any, report: Any) -> None:
    """Not to the first, nor to one that failed."""
    for number in (1, 2, 3):
        deploy(Desired(RELEASE, (config("a"),), options={"x": number}), fake, report=report)
    fake.store.refuse = no_apply
    with pytest.raises(Refusal):
        deploy(Desired(RELEASE, (config("a", k="1"),), options={"x": 4}), fake, report=report)
    fake.store.refuse = lambda live, dry_run: None
    assert rollback(fake, RELEASE, report=report).options == {"x": 3}
    assert rollback(fake, RELEASE, report=report).options == {"x": 3}
    assert rollback(fake, RELEASE, 2, report=report).options == {"x": 2}


def no_apply(live: Any, dry_run: Any) -> Refusal | None:
    """Refuse what was not refused in the dry run: a quota that was used up meanwhile."""
    if dry_run or live["kind"] in ("Lease", "Secret"):
        return None
    error = Refusal("exceeded quota")
    error.status = 403
    return error


def test_an_apply_that_is_refused_ends_the_deploy(fake: Any, report: Any) -> None:
    """Though its dry run was good: the revision has failed, and what ran before stays."""
    deploy(Desired(RELEASE, (config("old"),)), fake, report=report)
    fake.store.refuse = no_apply
    with pytest.raises(Refusal, match="exceeded quota"):
        deploy(Desired(RELEASE, (config("new"), workload())), fake, report=report)
    assert [r.status for r in history(fake, RELEASE)] == ["good", "failed"]
    assert fake.names("ConfigMap", "Deployment") == {"old"}


def test_many_failures_do_not_push_the_last_good_revision_out(fake: Any, report: Any) -> None:
    """It is what a rollback needs."""
    deploy(Desired(RELEASE, (config("a"),)), fake, report=report)
    good = revisions.records(fake, RELEASE)
    failed = [
        attrs.evolve(good[0].revision(), number=number, status="failed") for number in range(2, 14)
    ]
    for revision in failed:
        revisions.create(fake, revision)
    revisions.forget_old(fake, revisions.records(fake, RELEASE))
    left = [record.number for record in revisions.records(fake, RELEASE)]
    assert left == [1, *range(4, 14)]
    deploy(Desired(RELEASE, (config("b"),)), fake, report=report)
    rollback(fake, RELEASE, report=report)
    assert fake.names("ConfigMap") == {"a"}


def test_deploys_that_do_not_end_leave_few_revisions(fake: Any, report: Any) -> None:
    """Each of a row of deploys replaces the one before; every look reads all revisions.

    The good ones stay, and what the unfinished ones have left is still known.
    """
    for number in range(3):
        deploy(Desired(RELEASE, (config("a"),), options={"x": number}), fake, report=report)
    for number in range(25):
        fake.store.die_after = 4  # the Lease, an old revision or the new one, and some of the rest
        with pytest.raises(Killed):
            deploy(Desired(RELEASE, (config(f"b{number}"),)), fake, report=report)
        fake.revive()
        fake.delete(lease_ref(RELEASE))  # its process has ended
    found = history(fake, RELEASE)
    assert [r.number for r in found[:3]] == [1, 2, 3]
    assert len(found) <= 3 + revisions.LIMIT
    deploy(Desired(RELEASE, (config("c"),)), fake, report=report)
    assert fake.names("ConfigMap") == {"c"}
    assert [r.number for r in history(fake, RELEASE)][:1] == [3]
    assert len(history(fake, RELEASE)) == revisions.LIMIT + 1


def test_a_rollback_that_does_not_end_keeps_its_target(fake: Any, report: Any) -> None:
    """Also one that failed, and is older than all that are kept."""
    deploy(Desired(RELEASE, (config("a"),)), fake, report=report)
    fake.store.refuse = no_apply
    for _ in range(2 * revisions.LIMIT):
        with pytest.raises(Refusal):
            deploy(Desired(RELEASE, (config("b"),)), fake, report=report)
    target = history(fake, RELEASE)[1].number
    for _ in range(2 * revisions.LIMIT):
        with pytest.raises(Refusal):
            rollback(fake, RELEASE, target, report=report)
    fake.store.refuse = lambda live, dry_run: None
    rollback(fake, RELEASE, target, report=report)
    assert fake.names("ConfigMap") == {"b"}

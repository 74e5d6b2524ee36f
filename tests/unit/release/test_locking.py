"""One deploy of a release at a time: who has lost its Lease ends, who is alive keeps it."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, Interrupted
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release import deploy as release
from rigel_k8s.release import locking
from rigel_k8s.release.deploy import deploy, history
from rigel_k8s.release.lease import PROCESS, lease_ref, process
from rigel_k8s.release.locking import Held, hold
from rigel_k8s.release.types import Plan
from tests.support.controllers import running, unready
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired, ref, workload
from tests.support.recorder import Recorder
from tests.support.until import until

LEASE = lease_ref(RELEASE)


def manifest(holder: str, **notes: str) -> dict[str, Any]:
    return {
        "apiVersion": LEASE.api_version,
        "kind": LEASE.kind,
        "metadata": {"name": LEASE.name, "namespace": LEASE.namespace, "annotations": notes},
        "spec": {"holderIdentity": holder},
    }


@pytest.fixture
def mine(monkeypatch: pytest.MonkeyPatch) -> Held:
    """The Lease that the next deploy holds; the test may lose it."""
    made = Held()

    @contextmanager
    def hold(*_: Any, **__: Any) -> Iterator[Held]:
        yield made

    monkeypatch.setattr(release, "hold", hold)
    return made


def test_a_deploy_that_has_lost_its_lease_ends_before_it_prunes(
    fake: FakeCluster, report: Any, mine: Held
) -> None:
    """Another deploy may be under way: nothing is deleted, and the revision is not good."""
    deploy(desired(config("old")), fake, report=report)
    mine.lost.set()
    with pytest.raises(ClusterError, match="lost its Lease"):
        deploy(desired(config("new")), fake, report=report)
    assert [r.status for r in history(fake, RELEASE)] == ["good", "failed"]
    assert ref("ConfigMap", "old") in fake.objects


def test_a_wait_ends_when_the_lease_is_lost(fake: FakeCluster, report: Any, mine: Held) -> None:
    """Not only when everything is ready, or never."""

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        mine.lost.set()
        return unready(pod) if not release_it.is_set() else running(pod)

    release_it = threading.Event()
    assert fake.store.controllers
    fake.store.controllers.kubelet = kubelet
    timer = threading.Timer(5, release_it.set)  # a wait that goes on ends as well, later
    timer.start()
    with pytest.raises(ClusterError, match="lost its Lease"):
        deploy(desired(workload()), fake, report=report, timeout=20)
    timer.cancel()
    assert not release_it.is_set()


@pytest.mark.parametrize("how", ["taken over", "deleted"])
def test_a_lease_that_is_anothers_is_lost_and_left_alone(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch, how: str
) -> None:
    """The renewal finds another version, or none."""
    monkeypatch.setattr(locking, "RENEW", 0.01)
    other = fake.as_manager("other")
    with hold(fake, RELEASE, report, threading.Event(), patience=0) as mine:
        assert not mine.lost.is_set()
        fake.store.objects.pop(LEASE)
        if how == "taken over":
            other.create(manifest("ann@far"))
        until(mine.lost.is_set, "loss", 5, every=0.01)
        with pytest.raises(ClusterError, match="lost its Lease"):
            mine.check()
    assert (LEASE in fake.objects) == (how == "taken over")


def test_a_lease_is_renewed_and_given_back(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(locking, "RENEW", 0.01)
    with hold(fake, RELEASE, report, threading.Event(), patience=0) as mine:
        first = fake.objects[LEASE]["metadata"]["resourceVersion"]
        until(
            lambda: fake.objects[LEASE]["metadata"]["resourceVersion"] != first,
            "renewal",
            5,
            every=0.01,
        )
        mine.check()
    assert LEASE not in fake.objects


class Beating(FakeCluster):
    """A cluster on which another machine's deploy renews its Lease whenever somebody looks."""

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        found = super().get(ref)
        if ref == LEASE and found is not None and len(self.calls) < 100:
            self.store.version += 1
            self.objects[ref]["metadata"]["resourceVersion"] = str(self.store.version)
        return found


def test_a_lease_that_is_renewed_is_not_taken(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However old it is: only whether it changes counts."""
    monkeypatch.setattr(locking, "LOOK", 0.01)
    monkeypatch.setattr(locking, "DURATION", 0.1)
    fake.create(manifest("ann@far"))
    with pytest.raises(ClusterError, match="being changed by ann@far"):
        deploy(desired(config()), Beating(fake.store), report=report, lock_timeout=0.3)
    assert fake.objects[LEASE]["spec"]["holderIdentity"] == "ann@far"
    assert ref("ConfigMap", "c") not in fake.objects


def test_a_lease_that_nobody_renews_is_taken_over_when_it_has_expired(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(locking, "LOOK", 0.01)
    monkeypatch.setattr(locking, "DURATION", 0.1)
    fake.create(manifest("ann@far"))
    assert deploy(desired(config()), fake, report=report).status == "good"
    assert "being changed by ann@far" in report.lines[0]
    assert report.lines[0].endswith("waiting for its end, 300 s at most")
    assert LEASE not in fake.objects


def test_a_dead_process_of_this_machine_holds_nothing(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Killed and started again: no quarter of a minute is lost."""
    monkeypatch.setattr(locking, "LOOK", 0.01)
    monkeypatch.setattr(locking, "DURATION", 0.1)
    boot, space, pid, _ = process().split()
    fake.create(manifest("me@here", **{PROCESS: f"{boot} {space} {pid} 0"}))
    deploy(desired(config()), fake, report=report)
    assert not [line for line in report.lines if "waiting" in line]


def test_a_deploy_that_shall_not_wait_fails_at_once(fake: FakeCluster, report: Any) -> None:
    """With --lock-timeout 0 it names the other deploy and writes nothing."""
    fake.create(manifest("me@here", **{PROCESS: process()}))
    with pytest.raises(ClusterError, match="being changed by me@here since"):
        deploy(desired(config()), fake, report=report, lock_timeout=0)
    assert report.lines == []
    assert ref("ConfigMap", "c") not in fake.objects


def test_a_deploy_waits_for_the_one_before_it_and_does_nothing_twice(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It reports for whom it waits; what the other one has done meanwhile is not done again."""
    monkeypatch.setattr(locking, "LOOK", 0.01)
    started, go_on = threading.Event(), threading.Event()

    def pause(_: Plan) -> None:
        started.set()
        assert go_on.wait(20)

    first = threading.Thread(
        target=deploy,
        args=(desired(config(k="1")), fake),
        kwargs={"report": Recorder(), "before": pause},
    )
    first.start()
    assert started.wait(20)

    class Waiting(Recorder):
        def line(self, text: str) -> None:
            super().line(text)
            go_on.set()

    waiting = Waiting()
    assert deploy(desired(config(k="1")), fake, report=waiting).number == 1
    first.join()
    assert waiting.lines == [waiting.lines[0]]
    assert f"process {os.getpid()} since" in waiting.lines[0]
    assert [r.status for r in history(fake, RELEASE)] == ["good"]
    assert LEASE not in fake.objects


def test_a_wait_for_another_deploy_can_be_interrupted(fake: FakeCluster, report: Any) -> None:
    fake.create(manifest("me@here", **{PROCESS: process()}))
    cancel = threading.Event()
    threading.Timer(0.1, cancel.set).start()
    with pytest.raises(Interrupted, match="before anything was changed"):
        deploy(desired(config()), fake, report=report, cancel=cancel)


def test_an_unchanged_deploy_removes_the_lease_of_one_that_was_killed(
    fake: FakeCluster, report: Any
) -> None:
    """It takes none itself, so without that the Lease would stay until the next change."""
    wanted = desired(config())
    deploy(wanted, fake, report=report)
    boot, space, pid, _ = process().split()
    fake.create(manifest("me@here", **{PROCESS: f"{boot} {space} {pid} 0"}))
    report.entries.clear()
    assert deploy(wanted, fake, report=report).number == 1
    assert report.lines == ["removed the Lease of me@here, which was interrupted"]
    assert LEASE not in fake.objects


def test_an_unchanged_deploy_leaves_the_lease_of_one_that_is_under_way(
    fake: FakeCluster, report: Any
) -> None:
    wanted = desired(config())
    deploy(wanted, fake, report=report)
    fake.create(manifest("me@here", **{PROCESS: process()}))
    deploy(wanted, fake, report=report)
    assert LEASE in fake.objects

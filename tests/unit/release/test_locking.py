"""One deploy of a release at a time: who has lost its Lease ends, who is alive keeps it."""

from __future__ import annotations

import os
import threading
from typing import Any, cast

import attrs
import pytest

from rigel_k8s.errors import ClusterError, ConflictError, Interrupted
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release import locking
from rigel_k8s.release.locking import (
    DURATION,
    PROCESS,
    RENEW,
    Held,
    hold,
    is_alive,
    lease_ref,
    process,
)
from rigel_k8s.release.revisions import history
from rigel_k8s.release.types import DeployOptions
from tests.support.clock import Clock, Waits
from tests.support.controllers import running, unready
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, config, desired, ref, workload
from tests.support.recorder import Recorder
from tests.support.releases import deploy, down
from tests.support.until import until

LEASE = lease_ref(RELEASE)


def manifest(holder: str, **notes: str) -> dict[str, Any]:
    return {
        "apiVersion": LEASE.api_version,
        "kind": LEASE.kind,
        "metadata": {"name": LEASE.name, "namespace": LEASE.namespace, "annotations": notes},
        "spec": {"holderIdentity": holder},
    }


def take_over(fake: FakeCluster) -> None:
    """Let a deploy of another machine take the Lease, as one does that has waited for it."""
    held = fake.objects[LEASE]["metadata"]
    taken = manifest("ann@far")
    taken["metadata"] |= {key: held[key] for key in ("uid", "resourceVersion")}
    fake.as_manager("other").replace(taken)


@attrs.define
class Losing(FakeCluster):
    """A cluster on which another deploy takes the Lease right after the write of an object."""

    last: ObjectRef = LEASE

    def apply(self, made: Any, **options: Any) -> Any:
        result = super().apply(made, **options)
        return result if options.get("dry_run") else self.lose(result, ref_of(made))

    def create(self, made: Any, **options: Any) -> Any:
        return self.lose(super().create(made, **options), ref_of(made))

    def delete(self, ref: ObjectRef, **options: Any) -> bool:
        return bool(self.lose(super().delete(ref, **options), ref))

    def lose(self, result: Any, ref: ObjectRef) -> Any:
        if ref == self.last:
            take_over(self)
        return result


@pytest.fixture
def unsure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each renewal counts as long ago, as after an outage; no thread renews meanwhile."""
    monkeypatch.setattr(locking, "SURE", 0.0)
    monkeypatch.setattr(locking, "RENEW", 60.0)


@pytest.mark.usefixtures("unsure")
def test_a_holder_whose_lease_was_taken_writes_nothing_more(fake: FakeCluster, report: Any) -> None:
    """Neither its record nor an object: they are the other deploy's by now, and it says whose."""
    deploy(desired(config("old")), fake, report=report)
    with pytest.raises(
        ClusterError, match="Lease is lost: release demo is being changed by ann@far"
    ):
        deploy(desired(config("new")), fake, report=report, before=lambda _: take_over(fake))
    assert [r.status for r in history(fake, RELEASE)] == ["good"]
    assert fake.names("ConfigMap") == {"old"}
    assert fake.objects[LEASE]["spec"]["holderIdentity"] == "ann@far"


@pytest.mark.usefixtures("unsure")
@pytest.mark.parametrize(
    ("last", "there"),
    [
        (ref("ConfigMap", "a"), {"old", "a"}),
        (ref("Deployment", "w"), {"old", "a"}),
    ],
)
def test_a_lease_taken_during_the_apply_stops_it(
    fake: FakeCluster, report: Any, last: ObjectRef, there: set[str]
) -> None:
    """Before the next object, before anything is pruned; the revision is left to its successor."""
    deploy(desired(config("old")), fake, report=report)

    with pytest.raises(ClusterError, match="Lease is lost"):
        deploy(desired(config("a"), workload("w")), Losing(fake.store, last=last), report=report)
    assert fake.names("ConfigMap") == there
    assert (ref("Deployment", "w") in fake.objects) == (last.kind == "Deployment")
    assert [r.status for r in history(fake, RELEASE)] == ["good", "pending"]


@pytest.mark.usefixtures("unsure")
def test_a_lease_taken_at_the_end_leaves_the_revision_pending(
    fake: FakeCluster, report: Any
) -> None:
    """While the ROS graph is watched, say: what is good is for the other deploy to say."""
    with pytest.raises(ClusterError, match="Lease is lost"):
        deploy(desired(config()), fake, report=report, verify=lambda: take_over(fake))
    assert [r.status for r in history(fake, RELEASE)] == ["pending"]


@pytest.mark.parametrize(("part", "alive"), [(None, True), (0, None), (1, None), (3, False)])
def test_only_a_process_of_this_machine_can_be_looked_for(part: int | None, alive: Any) -> None:
    """One of another boot or another container may have our very number."""
    words = process().split()
    if part is not None:
        words[part] = "0"
    assert is_alive(manifest("me", **{PROCESS: " ".join(words)})) is alive
    assert is_alive(manifest("me")) is None


@pytest.mark.usefixtures("unsure")
@pytest.mark.parametrize(
    ("last", "there"),
    [(LEASE, {"a"}), (ref("ConfigMap", "a"), set())],
    ids=["before its first deletion", "before it forgets the history"],
)
def test_a_removal_stops_when_its_lease_was_taken(
    fake: FakeCluster, report: Any, last: ObjectRef, there: set[str]
) -> None:
    """What the other deploy makes is not deleted; it may have written its first revision."""
    deploy(desired(config("a")), fake, report=report)
    with pytest.raises(ClusterError, match="Lease is lost"):
        down(Losing(fake.store, last=last), RELEASE, volumes=False, report=report)
    assert fake.names("ConfigMap") == there
    assert len(history(fake, RELEASE)) == 1


@pytest.mark.usefixtures("unsure")
def test_a_holder_that_no_one_has_followed_goes_on(fake: FakeCluster, report: Any) -> None:
    """After an outage it renews its Lease first, and then writes."""
    assert deploy(desired(config()), fake, report=report).status == "good"
    assert ("patch", LEASE) in fake.calls
    assert LEASE not in fake.objects


class Conflicting(FakeCluster):
    """Carries a creation out, and answers that it is in conflict."""

    def create(self, manifest: Any, **more: Any) -> Any:
        super().create(manifest, **more)
        raise ConflictError("it has been modified")


def test_a_lease_that_was_made_by_a_request_in_conflict_is_ours(
    fake: FakeCluster, report: Any
) -> None:
    """Otherwise the process would wait for its own end (bench.chaos, seed 11212)."""
    with hold(Conflicting(fake.store), RELEASE, DeployOptions(report=report, lock_timeout=0)):
        holder = fake.objects[LEASE]["spec"]["holderIdentity"]
        assert holder.endswith(f", process {os.getpid()}")
    assert LEASE not in fake.objects


def test_a_renewal_whose_answer_was_lost_is_ours(fake: FakeCluster, report: Any) -> None:
    """The version is another one, the holder is not; when it arrived is not known."""
    with hold(fake, RELEASE, DeployOptions(report=report, lock_timeout=0)) as mine:
        fake.patch(LEASE, {"spec": {"renewTime": "later"}})
        mine.renew()
        mine.check()
        assert fake.objects[LEASE]["spec"]["renewTime"] != "later"


def test_a_lease_that_was_taken_unnoticed_is_not_removed(fake: FakeCluster, report: Any) -> None:
    """It has the same UID: who takes a Lease over writes the same object."""
    with hold(fake, RELEASE, DeployOptions(report=report, lock_timeout=0)):
        take_over(fake)
    assert fake.objects[LEASE]["spec"]["holderIdentity"] == "ann@far"


def test_a_renewal_that_fails_is_not_a_loss(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the API server is away no one else can take the Lease; but nothing may be written."""

    class Away(FakeCluster):
        away = False

        def patch(self, *words: Any, **options: Any) -> Any:
            if Away.away:
                raise ClusterError("the cluster does not answer")
            return super().patch(*words, **options)

    monkeypatch.setattr(locking, "SURE", 0.0)
    monkeypatch.setattr(locking, "RENEW", 0.01)
    with hold(Away(fake.store), RELEASE, DeployOptions(report=report, lock_timeout=0)) as mine:
        Away.away = True
        with pytest.raises(ClusterError, match="does not answer"):
            mine.confirm()
        mine.check()
        Away.away = False
        mine.confirm()
    assert LEASE not in fake.objects


def test_a_wait_ends_when_the_lease_is_lost(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not only when everything is ready, or never."""
    monkeypatch.setattr(locking, "RENEW", 0.01)

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        if fake.objects[LEASE]["spec"]["holderIdentity"] != "ann@far":
            take_over(fake)
        return unready(pod) if not release_it.is_set() else running(pod)

    release_it = threading.Event()
    assert fake.store.controllers
    fake.store.controllers.kubelet = kubelet
    timer = threading.Timer(60, release_it.set)  # a wait that goes on ends as well, later
    timer.start()
    with pytest.raises(ClusterError, match="Lease is lost"):
        deploy(desired(workload()), fake, report=report, timeout=120)
    timer.cancel()
    assert not release_it.is_set()


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("taken over", "changed by ann@far"),
        ("deleted", "another process has removed Lease n/rigel.demo"),
        ("namespace", "the namespace n is being deleted"),
    ],
)
def test_a_lease_that_is_anothers_is_lost_and_left_alone(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch, how: str, said: str
) -> None:
    """The renewal finds another version, or none."""
    monkeypatch.setattr(locking, "RENEW", 0.01)
    other = fake.as_manager("other")
    with hold(fake, RELEASE, DeployOptions(report=report, lock_timeout=0)) as mine:
        assert not mine.lost.is_set()
        if how == "namespace":
            space = fake.objects[ObjectRef("v1", "Namespace", "", "n")]
            space["metadata"]["deletionTimestamp"] = "2026-01-01T00:00:00Z"
        fake.store.objects.pop(LEASE)
        if how == "taken over":
            other.create(manifest("ann@far"))
        until(mine.lost.is_set, "loss", every=0.01)
        with pytest.raises(ClusterError, match=f"Lease is lost: .*{said}"):
            mine.check()
    assert (LEASE in fake.objects) == (how == "taken over")


@attrs.define
class Outage(FakeCluster):
    """A cluster that is away once, for longer than a Lease lasts; its holder is alive."""

    clock: Any = None
    looks: int = 0

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        if ref == LEASE:
            self.looks += 1
            if self.looks == 4:
                self.clock.now += 100
            if self.looks == 6:
                self.store.objects.pop(LEASE)
        return super().get(ref)


def test_a_time_without_answers_does_not_count(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After an outage of the API server a holder has its whole time again to renew its Lease."""
    clock = Clock()
    monkeypatch.setattr(locking, "time", clock)
    monkeypatch.setattr(locking, "LOOK", 0.001)
    fake.create(manifest("ann@far"))
    cluster = Outage(fake.store, clock=clock)
    with hold(cluster, RELEASE, DeployOptions(report=report, lock_timeout=300)):
        assert ("replace", LEASE) not in fake.calls
    assert cluster.looks == 6


class Beating(FakeCluster):
    """A cluster on which another machine's deploy renews its Lease whenever somebody looks."""

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        if ref == LEASE and ref in self.objects:
            self.store.version += 1
            self.objects[ref]["metadata"]["resourceVersion"] = str(self.store.version)
        return super().get(ref)


def test_a_lease_that_is_renewed_is_not_taken(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However old it is: only whether it changes counts."""
    clock = Clock()
    monkeypatch.setattr(locking, "time", clock)
    fake.create(manifest("ann@far"))
    words = {"report": report, "cancel": Waits(clock), "lock_timeout": 3 * DURATION}
    with pytest.raises(ClusterError, match="being changed by ann@far"):
        deploy(desired(config()), Beating(fake.store), **words)
    assert clock.now == 3 * DURATION
    assert fake.objects[LEASE]["spec"]["holderIdentity"] == "ann@far"
    assert ref("ConfigMap", "c") not in fake.objects


def test_a_lease_that_nobody_renews_is_taken_over_when_it_has_expired(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(locking, "time", clock)
    fake.create(manifest("ann@far"))
    waits = Waits(clock)
    assert deploy(desired(config()), fake, report=report, cancel=waits).status == "good"
    assert clock.now == DURATION
    (line,) = [line for line in report.lines if "waiting" in line]
    assert "being changed by ann@far" in line
    assert line.endswith("waiting for its end, 300 s at most")
    assert LEASE not in fake.objects


def test_a_dead_process_of_this_machine_holds_nothing(fake: FakeCluster, report: Any) -> None:
    """Killed and started again: no quarter of a minute is lost."""
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


def test_a_wait_for_another_deploy_can_be_interrupted(fake: FakeCluster) -> None:
    fake.create(manifest("me@here", **{PROCESS: process()}))
    cancel = threading.Event()

    class Waiting(Recorder):
        def line(self, text: str) -> None:
            super().line(text)
            cancel.set()

    waiting = Waiting()
    with pytest.raises(Interrupted, match="before anything was changed"):
        deploy(desired(config()), fake, report=waiting, cancel=cancel)
    assert "waiting for its end" in waiting.lines[0]


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


def test_a_renewal_is_relied_on_for_less_than_others_wait() -> None:
    """Who waits takes a Lease after DURATION: a write begins well before that."""
    held = Held(cast(Any, None), {})
    assert held.is_sure()
    held.renewed -= DURATION - 2 * RENEW
    assert held.is_sure()
    held.renewed -= RENEW
    assert not held.is_sure()

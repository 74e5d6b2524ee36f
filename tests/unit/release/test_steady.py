"""A workload between two crashes looks ready; it counts when it has stayed up for a while."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, RolloutFailed
from rigel_k8s.release.rollout import wait
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.rollout.standing import STEADY, CrashLog, Standing
from rigel_k8s.release.rollout.view import ReleaseView, find_related
from tests.support.clock import leap_when_shown
from tests.support.controllers import Controllers, crash_status, running, unready
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import desired, ref, workload
from tests.support.releases import deploy

TALKER = ref("Deployment", "talker")


def restarted(count: int) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return a kubelet whose containers have come back so many times, and run."""

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        status = running(pod)
        for container in status["containerStatuses"]:
            container["restartCount"] = count
            container["lastState"] = {"terminated": {"exitCode": 1, "reason": "Error"}}
        return status

    return kubelet


def test_ready_between_two_crashes_is_not_ready(fake: FakeCluster) -> None:
    """Each crash begins the while again."""
    fake.apply(workload())
    standing, now = Standing({TALKER: fake.objects[TALKER]}), 1000.0
    standing.rolling.add(TALKER)

    def look() -> bool:
        of_kind = {
            kind: [live for live in fake.objects.values() if live["kind"] == kind]
            for kind in ("ReplicaSet", "Pod")
        }
        related = find_related(of_kind["ReplicaSet"], of_kind["Pod"])
        standing.look({TALKER: fake.objects[TALKER]}, related, now)
        return standing.is_ready(TALKER)

    for count in (1, 2):
        fake.store.controllers = Controllers(restarted(count))
        fake.settle()
        assert not look()
        now += STEADY - 1
        assert not look()
    now += 2
    assert look()


def test_ready_before_its_pod_was_seen_is_not_enough(fake: FakeCluster) -> None:
    """The watch of Deployments may be ahead of that of pods, which shows a crash."""
    fake.apply(workload())
    standing = Standing({TALKER: fake.objects[TALKER]})
    standing.look({TALKER: fake.objects[TALKER]}, find_related([], []), 1000.0)
    fake.settle()
    live, sets = {TALKER: fake.objects[TALKER]}, fake.list("apps/v1", "ReplicaSet", "n")
    standing.look(live, find_related(sets, []), 1001.0)
    assert standing.is_enough(1001.0)
    assert standing.list_unseen() == [TALKER]
    with ReleaseView(fake, "n", 1.0) as view:  # type: ignore[arg-type]
        assert not wait.sees_pods(view, standing, 1001.5)
        assert wait.sees_pods(view, standing, 1001.0 + wait.BEHIND)
    standing.look(live, find_related(sets, fake.list("v1", "Pod", "n")), 1002.0)
    assert standing.list_unseen() == []


def test_while_it_waits_for_its_restart_it_is_not_up() -> None:
    """Kubernetes waits for 10 s after the second crash: 3 s of running do not make it steady."""
    crashes = CrashLog()

    def note(now: float, state: dict[str, Any], restarts: int) -> set[Any]:
        status = {"containerStatuses": [{"state": state, "restartCount": restarts}]}
        crashes.note(TALKER, [{"metadata": {"uid": "new"}, "status": status}], now)
        return crashes.find_unsteady(now)

    note(1000.0, {"terminated": {"exitCode": 1}}, 1)
    note(1010.0, {"waiting": {"reason": "CrashLoopBackOff"}}, 1)
    assert note(1011.0, {"running": {}}, 2) == {TALKER}
    assert note(1010.0 + STEADY - 1, {"running": {}}, 2) == {TALKER}
    assert note(1010.0 + STEADY, {"running": {}}, 2) == set()


def test_what_ends_while_it_is_deleted_is_no_crash() -> None:
    """The old pod of an update by Recreate, whose program ends with 130 as rclpy's examples do."""
    old = {"metadata": {"uid": "old", "deletionTimestamp": "2026-01-01T00:00:00Z"}}
    ended = {"state": {"terminated": {"exitCode": 130}}, "restartCount": 1}
    crashes = CrashLog()
    crashes.note(TALKER, [{**old, "status": {"containerStatuses": [ended]}}], 1000.0)
    new = {"metadata": {"uid": "new"}}
    crashes.note(TALKER, [{**new, "status": {"containerStatuses": [{"state": {}}]}}], 1001.0)
    assert crashes.find_unsteady(1001.0) == set()
    crashes.note(TALKER, [{**new, "status": {"containerStatuses": [ended]}}], 1002.0)
    assert crashes.find_unsteady(1002.0) == {TALKER}


def test_a_crash_that_healed_before_anyone_looked_is_told(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kubelet restarts a container at once the first time: it may be ready at every look."""
    monkeypatch.setattr(wait, "EXPLAIN", 0.0)
    leap_when_shown(monkeypatch, report, STEADY, ("talker", "exited with code 1"))
    fake.store.controllers = Controllers(restarted(1))
    deploy(desired(workload()), fake, report=report)
    assert report.warnings == ["talker: container node exited with code 1\n    last words"]


def test_the_old_pod_of_a_recreate_is_none_of_the_newest(fake: FakeCluster) -> None:
    """Until it has ended there is no newer ReplicaSet: its crash is none of its repair."""
    fake.apply(workload(image="app:1"))
    fake.settle()
    sets, pods = fake.list("apps/v1", "ReplicaSet", "n"), fake.list("v1", "Pod", "n")
    related, live = find_related(sets, pods), fake.objects[TALKER]
    assert related.list_newest_pods(live) == pods
    live["spec"]["template"]["spec"]["containers"][0]["image"] = "app:2"
    assert related.list_pods(live) == pods
    assert related.list_newest_pods(live) == []


def test_nodes_that_end_alike_fail_as_early_as_one(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second one starts late, and ends with the last words of the first."""
    monkeypatch.setattr(wait, "EXPLAIN", 0.0)
    monkeypatch.setattr(wait, "LOOK", 0.01)
    looks: list[set[str]] = []  # the nodes that have a cause
    find_causes = Standing.find_causes

    def note_causes(self: Standing) -> list[Any]:
        found = list(find_causes(self))
        looks.append({ref.name for ref, _ in found})
        return found

    monkeypatch.setattr(Standing, "find_causes", note_causes)
    clock = SimpleNamespace(monotonic=lambda: 1000.0 + len(looks))  # a second for each look
    monkeypatch.setattr(wait, "time", clock)
    count = itertools.count()

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        late = pod["metadata"]["name"].startswith("listener")
        if late and sum("talker" in look for look in looks) < Patience().crash + 1:
            return {**unready(pod), "hostIP": f"10.0.0.{next(count)}"}
        status = crash_status(pod)
        status["containerStatuses"][0]["lastState"]["terminated"]["message"] = "no module rover"
        return status

    fake.store.controllers = Controllers(kubelet)
    with pytest.raises(RolloutFailed, match=r"(talker, listener|listener, talker) did not become"):
        deploy(desired(workload(), workload("listener")), fake, report=report)
    assert sum(len(look) > 1 for look in looks) == 1


def test_a_wait_for_what_was_refused_to_look_at_ends(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A watch that the cluster refuses is the error, not a timeout later."""

    def watch(self: Any, api_version: str, kind: str, *_: Any, **__: Any) -> Any:
        raise ClusterError(f"you may not watch {kind}s")

    monkeypatch.setattr(FakeCluster, "watch", watch)
    with pytest.raises(ClusterError, match="you may not watch Deployments"):
        deploy(desired(workload()), fake, report=report, timeout=30)

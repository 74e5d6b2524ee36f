"""A workload between two crashes looks ready; it counts when it has stayed up for a while."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, RolloutFailed
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.release.rollout import wait
from rigel_k8s.release.rollout.crashes import STEADY
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.rollout.view import ReleaseView
from rigel_k8s.release.rollout.wait import Waiter
from tests.support.controllers import Controllers, crash_status, running
from tests.support.fake_cluster import FakeCluster
from tests.support.manifests import RELEASE, desired, ref, workload
from tests.support.releases import deploy

TALKER = ref("Deployment", "talker")


def restarted(count: int) -> Callable[[dict[str, Any]], dict[str, Any]]:
    """Return a kubelet whose containers have come back so many times, and run."""

    def kubelet(pod: dict[str, Any]) -> dict[str, Any]:
        status = running(pod)
        for container in status["containerStatuses"]:
            container["restartCount"] = count
        return status

    return kubelet


def waiter(fake: FakeCluster, report: Any) -> Waiter:
    made = Waiter(
        fake,
        RELEASE,
        report,
        threading.Event(),
        60,
        Patience(),
        "",
        lambda: None,  # type: ignore[arg-type]
    )
    made.rolling.add(TALKER)
    return made


def view(fake: FakeCluster) -> ReleaseView:
    """Return a view that has seen what is there."""
    found = ReleaseView(fake, "n", 1)  # type: ignore[arg-type]
    for live in fake.objects.values():
        found.objects[live["apiVersion"], live["kind"]][ref_of(live)] = live
    return found


def test_ready_between_two_crashes_is_not_ready(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each crash begins the while again."""
    clock = [1000.0]
    monkeypatch.setattr(wait.time, "monotonic", lambda: clock[0])
    fake.apply(workload())
    targets = {TALKER: fake.objects[TALKER]}
    made = waiter(fake, report)
    for crashes in (1, 2):
        fake.store.controllers = Controllers(restarted(crashes))
        fake.settle()
        assert not made.all_ready(view(fake), targets)
        clock[0] += STEADY - 1
        assert not made.all_ready(view(fake), targets)
    clock[0] += 2
    assert made.all_ready(view(fake), targets)


def test_a_workload_that_crashes_is_told_with_its_last_words(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And given up when it has crashed for long."""
    monkeypatch.setattr(wait, "EXPLAIN", 0.02)
    fake.store.controllers = Controllers(crash_status)
    hasty = Patience(crash=0.1, crash_limit=0.2)
    message = "talker did not become ready: container node exited with code 1"
    with pytest.raises(RolloutFailed, match=message) as caught:
        deploy(desired(workload()), fake, report=report, patience=hasty, timeout=30)
    assert caught.value.details == ("    last words",)
    assert report.warnings == []


def test_a_wait_for_what_was_refused_to_look_at_ends(
    fake: FakeCluster, report: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A watch that the cluster refuses is the error, not a timeout later."""

    def watch(self: Any, api_version: str, kind: str, *_: Any, **__: Any) -> Any:
        raise ClusterError(f"you may not watch {kind}s")

    monkeypatch.setattr(FakeCluster, "watch", watch)
    with pytest.raises(ClusterError, match="you may not watch Deployments"):
        deploy(desired(workload()), fake, report=report, timeout=30)

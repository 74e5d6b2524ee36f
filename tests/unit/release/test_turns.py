"""A pod that waits to take over is no failed roll-out: it is shown, and waited for."""

from __future__ import annotations

from typing import Any, cast

import attrs
import pytest

from rigel_k8s.errors import RolloutFailed
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout import wait as waiting
from rigel_k8s.release.rollout.account import Account
from rigel_k8s.release.rollout.patience import Ledger, Patience
from rigel_k8s.release.rollout.standing import Standing
from rigel_k8s.release.rollout.view import REPLICA_SET, Related
from tests.support.manifests import desired, ref, workload
from tests.support.recorder import Recorder
from tests.support.releases import make_run

NODE = ref("Deployment", "robot")
WAITS = "waits to take over from robot-1: /navigate has 1 goal"
STEP = 10.0  # seconds between two looks


@attrs.define
class View:
    """A cluster whose new pod is ready from a moment on, and says until then why it is not."""

    says: str
    ready_at: float
    now: float = 0.0

    @property
    def complete(self) -> bool:
        """Whether all has been listed."""
        return True

    @property
    def refused(self) -> set[Any]:
        """What cannot be watched: this one shows no ReplicaSets."""
        return {REPLICA_SET}

    def time(self) -> float:
        return self.now

    def find(self, one: ObjectRef) -> dict[str, Any]:
        made = workload(one.name)
        ready = int(self.now >= self.ready_at)
        status = {"replicas": 2 - ready, "updatedReplicas": 1, "availableReplicas": 1}
        return {**made, "metadata": {**made["metadata"], "uid": "w"}, "status": status}

    def find_related(self) -> Related:
        pod = {"metadata": {"name": "robot-2", "uid": "p"}, "spec": {}, "status": {}}
        about = {"involvedObject": {"uid": "p"}, "reason": "Unhealthy", "message": self.says}
        return Related(pods={"w": [pod]}, events={"p": [about]})

    def watch(self, *_: Any, **__: Any) -> None: ...

    def refresh(self, _: float) -> None:
        self.now += STEP


def follow(view: View, monkeypatch: pytest.MonkeyPatch, grace: int = 330) -> Recorder:
    """Wait for a roll-out of at most 60 s; the old pod may take longer to end."""
    told = Recorder()
    target = workload(NODE.name)
    target["spec"]["template"]["spec"]["terminationGracePeriodSeconds"] = grace
    cluster = type("Cluster", (), {"sum_outages": lambda _: 0.0, "logs": lambda *_, **__: []})()
    run = make_run(desired(), cluster, report=told, timeout=60.0)
    monkeypatch.setattr(waiting, "time", type("Clock", (), {"monotonic": staticmethod(view.time)}))
    monkeypatch.setattr(waiting, "all_run", lambda *_, last: last)
    monkeypatch.setattr("rigel_k8s.release.rollout.view.pods_of", lambda _, __, pods: list(pods))
    account = Account(run, Standing({NODE: target}), 1, Ledger(Patience()))
    waiting.follow(run, cast(Any, view), cast(Any, None), account, lambda: None)
    return told


def test_what_it_waits_for_is_shown_and_takes_no_time_of_the_rollout(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Goals of actions may take minutes, which the old pod has."""
    told = follow(View(f"Startup probe failed: {WAITS} [waits]", 250.0), monkeypatch)
    shown = f"0 of 1 new pod ready, the old version still runs; {WAITS}"
    assert (NODE.name, shown, False) in told.states
    assert told.states[-1][2]


@pytest.mark.parametrize(
    ("says", "ready", "grace"),
    [
        ("Startup probe failed: the node /robot does not exist yet", 90.0, 330),
        (f"Startup probe failed: {WAITS} [waits]", 250.0, 100),
    ],
)
def test_all_else_must_be_ready_in_time(
    monkeypatch: pytest.MonkeyPatch, says: str, ready: float, grace: int
) -> None:
    """And a pod waits no longer than the old one has to end."""
    with pytest.raises(RolloutFailed, match="not ready within 60 s"):
        follow(View(says, ready), monkeypatch, grace)

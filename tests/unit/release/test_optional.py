"""What a release is good without: it has a short while, and is then told and left behind."""

from __future__ import annotations

from typing import Any, cast

import attrs

from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout.account import Account
from rigel_k8s.release.rollout.causes import Cause
from rigel_k8s.release.rollout.patience import Ledger, Patience
from rigel_k8s.release.rollout.standing import GRACE, Standing
from rigel_k8s.release.rollout.view import Related
from rigel_k8s.release.status import WorkloadStatus
from tests.support.manifests import desired, ref, workload
from tests.support.recorder import Recorder
from tests.support.releases import make_run

NEEDED, EXTRA = ref("Deployment", "talker"), ref("Deployment", "ros-exporter")


def place(*names: str, remedy: str = "") -> Standing:
    """Return how far these and an optional workload are before the first look."""
    notes = {OPTIONAL_ANNOTATION: "true", REMEDY_ANNOTATION: remedy}
    wanted = {ref("Deployment", name): workload(name) for name in names}
    return Standing({**wanted, EXTRA: workload(EXTRA.name, **notes)})


def look(standing: Standing, now: float, *ready: ObjectRef) -> bool:
    """Look at them, and return whether the wait is over."""
    live = {
        one: {
            **workload(one.name),
            "metadata": {**workload(one.name)["metadata"], "uid": one.name},
            "status": {"replicas": 1, "updatedReplicas": 1, "availableReplicas": int(one in ready)},
        }
        for one in standing.targets
    }
    standing.look(live, Related(), now)
    return standing.is_enough(now)


def account(standing: Standing, told: Recorder) -> Account:
    run = make_run(desired(), cast(Any, None), report=told)
    return Account(run, standing, 0, Ledger(Patience()))


def test_what_is_needed_is_waited_for_whatever_else_there_is() -> None:
    standing = place("talker")
    assert not look(standing, 1000)
    assert not look(standing, 1000 + 10 * GRACE)
    assert not look(standing, 1000 + 20 * GRACE, EXTRA)


def test_what_is_optional_has_its_while_once_all_else_is_ready() -> None:
    standing, told = place("talker"), Recorder()
    assert not look(standing, 1000)
    assert not look(standing, 2000, NEEDED)
    assert not look(standing, 2000 + GRACE - 1, NEEDED)
    assert look(standing, 2000 + GRACE, NEEDED)
    account(standing, told).leave_behind()
    assert told.states == [("ros-exporter", "", True)], "no row beside the warning"
    assert told.warnings == [
        "ros-exporter is not ready: 0 of 1 ready; demo runs without it;"
        " `rigel status` shows its state"
    ]


def test_its_remedy_is_told_where_it_has_one() -> None:
    standing, told = place(remedy="do that"), Recorder()
    look(standing, 1000)
    account(standing, told).leave_behind()
    assert told.warnings[0].endswith("demo runs without it; do that")


def test_its_while_begins_anew_when_a_needed_one_falls_back() -> None:
    standing = place("talker")
    assert not look(standing, 1000, NEEDED)
    assert not look(standing, 1000 + 2 * GRACE)
    assert not look(standing, 1001 + 2 * GRACE, NEEDED)


def test_nothing_is_told_where_it_is_ready_in_time() -> None:
    standing, told = place(), Recorder()
    assert look(standing, 1000, EXTRA)
    account(standing, told).leave_behind()
    assert told.warnings == []


def test_status_is_good_without_it() -> None:
    plain = WorkloadStatus("Deployment", "x", 0, 1, False, "0 of 1 ready", ())
    assert not plain.ok
    assert attrs.evolve(plain, annotations={OPTIONAL_ANNOTATION: "true"}).ok


def test_of_two_causes_one_is_shown() -> None:
    """Two that hold at a time would take turns as the present state, a line each half second."""
    told = Recorder()
    causes = [Cause("image", "cannot be pulled"), Cause("mount", "no file")]

    class Wrong(Standing):
        def find_causes(self) -> Any:
            return ((NEEDED, cause) for cause in causes)

    made = account(Wrong({NEEDED: workload()}), told)
    made.note_causes(1000.0)
    made.note_causes(1001.0)
    assert told.states == [("talker", "cannot be pulled", False)]


def test_a_crash_is_shown_once_whatever_its_last_words() -> None:
    """They may have another order after each restart of the container."""
    told, words = Recorder(), iter(("one", "two"))

    class Crashing(Standing):
        def find_causes(self) -> Any:
            return [(NEEDED, Cause("crash", f"exited ({next(words)})", brief="exited"))]

    made = account(Crashing({NEEDED: workload()}), told)
    made.note_causes(1000.0)
    made.note_causes(1001.0)
    assert told.states == [("talker", "exited (one)", False)]

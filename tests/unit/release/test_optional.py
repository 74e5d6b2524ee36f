"""What a release is good without: it has a short while, and is then told and left behind."""

from __future__ import annotations

import threading
from typing import Any, cast

import attrs
import pytest

from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, is_optional
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout import wait
from rigel_k8s.release.rollout.causes import Cause
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.rollout.readiness import ObjectReadiness
from rigel_k8s.release.rollout.wait import GRACE, Waiter
from rigel_k8s.release.status import WorkloadStatus
from rigel_k8s.release.types import ReleaseId
from tests.support.recorder import Recorder

NEEDED = ObjectRef("apps/v1", "Deployment", "robots", "talker")
EXTRA = ObjectRef("apps/v1", "Deployment", "robots", "ros-exporter")


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The clock; the test sets it."""
    clock = [1000.0]
    monkeypatch.setattr(wait.time, "monotonic", lambda: clock[0])
    return clock


def waiter(told: Recorder, remedy: str = "") -> Waiter:
    made = Waiter(
        cast(Any, None),
        ReleaseId("robots", "app"),
        cast(Any, told),
        threading.Event(),
        60.0,
        Patience(),
        "",
        lambda: None,
    )
    made.optional = {EXTRA: remedy}
    made.states[EXTRA] = ObjectReadiness(False, True, "0 of 1 ready")
    return made


def test_what_is_needed_is_waited_for_whatever_else_there_is(now: list[float]) -> None:
    told = Recorder()
    made = waiter(told)
    assert not made.is_enough([NEEDED, EXTRA])
    now[0] += 10 * GRACE
    assert not made.is_enough([NEEDED])
    assert told.warnings == []


def test_what_is_optional_has_its_while_once_all_else_is_ready(now: list[float]) -> None:
    told = Recorder()
    made = waiter(told)
    now[0] += 10 * GRACE
    assert not made.is_enough([EXTRA])
    now[0] += GRACE - 1
    assert not made.is_enough([EXTRA])
    now[0] += 2
    assert made.is_enough([EXTRA])
    assert told.states == [("ros-exporter", "", True)], "no row beside the warning"
    assert told.warnings == [
        "ros-exporter is not ready: 0 of 1 ready; app runs without it;"
        " `rigel status` shows its state"
    ]


def test_its_remedy_is_told_where_it_has_one(now: list[float]) -> None:
    told = Recorder()
    made = waiter(told, "do that")
    made.is_enough([EXTRA])
    now[0] += GRACE + 1
    assert made.is_enough([EXTRA])
    assert told.warnings[0].endswith("app runs without it; do that")


def test_its_while_begins_anew_when_a_needed_one_falls_back(now: list[float]) -> None:
    made = waiter(Recorder())
    assert not made.is_enough([EXTRA])
    now[0] += GRACE + 1
    assert not made.is_enough([NEEDED, EXTRA])
    assert not made.is_enough([EXTRA])


def test_nothing_is_told_where_it_is_ready_in_time(now: list[float]) -> None:
    told = Recorder()
    assert waiter(told).is_enough([])
    assert told.warnings == []


def test_an_annotation_says_what_is_optional() -> None:
    plain: dict[str, Any] = {"metadata": {"name": "x"}}
    assert not is_optional(plain)
    assert is_optional({"metadata": {"annotations": {OPTIONAL_ANNOTATION: "true"}}})


def test_status_is_good_without_it() -> None:
    plain = WorkloadStatus("Deployment", "x", 0, 1, False, "0 of 1 ready", ())
    assert not plain.ok
    assert attrs.evolve(plain, annotations={OPTIONAL_ANNOTATION: "true"}).ok


def test_of_two_causes_one_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two that hold at a time would take turns as the present state, a line each half second."""
    shown: list[str] = []
    made = waiter(Recorder())
    causes = [(NEEDED, Cause("image", "cannot be pulled")), (NEEDED, Cause("mount", "no file"))]
    monkeypatch.setattr(Waiter, "find_causes", lambda *_: iter(causes))
    monkeypatch.setattr(Waiter, "show", lambda _, ref, text, **__: shown.append(text))
    made.look_for_causes(cast(Any, None), {}, 1000.0)
    made.look_for_causes(cast(Any, None), {}, 1001.0)
    assert set(shown) == {"cannot be pulled"}

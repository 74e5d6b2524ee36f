"""What live objects say about themselves."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.objects.facts import (
    DEFAULT_CLASS,
    find_condition,
    is_default_class,
    is_ending,
    is_met,
    is_ready,
    stays_ready,
)

READY = {"type": "Ready", "status": "True"}
OTHER = {"type": "Initialized", "status": "True"}


def live(*conditions: Any, **meta: Any) -> dict[str, Any]:
    return {"metadata": {"name": "x", **meta}, "status": {"conditions": list(conditions)}}


@pytest.mark.parametrize(
    ("one", "ready"),
    [
        (live(OTHER, READY), True),
        (live(OTHER), False),
        (live({**READY, "status": "False"}), False),
        (live({**READY, "status": "Unknown"}), False),
        (live(), False),
        ({"metadata": {}, "status": {"conditions": None}}, False),
        ({"metadata": {}, "status": None}, False),
        ({"metadata": {}}, False),
    ],
)
def test_ready_is_what_the_condition_says(one: dict[str, Any], ready: bool) -> None:  # noqa: FBT001
    """A pod that was just made has no conditions; a machine that is lost has unknown ones."""
    assert is_ready(one) is ready
    assert stays_ready(one) is ready


def test_a_pod_that_is_being_deleted_does_not_stay() -> None:
    """It may be ready for its whole grace period."""
    ending = live(READY, deletionTimestamp="2026-01-01T00:00:00Z")
    assert is_ending(ending)
    assert is_ready(ending)
    assert not stays_ready(ending)
    assert not is_ending(live(READY))


def test_conditions_are_found_by_their_kind() -> None:
    """Any of them, with what it says."""
    status = {"conditions": [OTHER, {"type": "Failed", "status": "True", "message": "why"}]}
    assert find_condition(status, "Failed")["message"] == "why"
    assert find_condition(status, "Ready") == {}
    assert is_met(status, "Failed")
    assert not is_met(status, "Ready")
    assert not is_met({}, "Ready")


def test_the_default_class_is_annotated() -> None:
    """With the word true; others have no annotations at all, or say false."""
    assert is_default_class({"metadata": {"annotations": {DEFAULT_CLASS: "true"}}})
    assert not is_default_class({"metadata": {"annotations": {DEFAULT_CLASS: "false"}}})
    assert not is_default_class({"metadata": {"annotations": None}})
    assert not is_default_class({"metadata": {}})

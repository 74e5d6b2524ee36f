"""The lanes name tests that are there."""

from __future__ import annotations

from pathlib import Path

import pytest

from ..lanes import AFTER, LANES, lane_of

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("start", LANES)
def test_each_lane_has_tests(start: str) -> None:
    """A file that was moved leaves its lane behind."""
    path = ROOT / start
    files = [path] if path.is_file() else list(path.rglob("test_*.py"))
    assert any(lane_of(f"{file.relative_to(ROOT)}::test") == LANES[start] for file in files)


@pytest.mark.parametrize(("lane", "before"), AFTER.items())
def test_who_waits_begins_later(lane: str, before: str) -> None:
    """Otherwise all processes could wait for a lane that nobody runs."""
    order = list(LANES.values())
    assert order.index(before) < order.index(lane)

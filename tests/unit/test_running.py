"""How the tests themselves are run: lanes, their order, and the skips that a run may have."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from ..lanes import AFTER, LANES, lane_of, turn_of
from ..skips import EXPECTED, find_unexpected

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("start", LANES)
def test_each_lane_has_tests(start: str) -> None:
    """A file that was moved takes its lane along."""
    path = ROOT / start
    files = [path] if path.is_file() else list(path.rglob("test_*.py"))
    assert any(lane_of(f"{file.relative_to(ROOT)}::test") == LANES[start] for file in files)


@pytest.mark.parametrize("start", [skip.tests for skip in EXPECTED])
def test_each_skip_is_of_tests_that_are_there(start: str) -> None:
    """A file that was moved takes its skips along."""
    assert (ROOT / start).exists()


@pytest.mark.parametrize(("lane", "before"), AFTER.items())
def test_who_waits_begins_later(lane: str, before: str) -> None:
    """Otherwise all processes could wait for a lane that nobody runs."""
    order = list(LANES.values())
    assert order.index(before) < order.index(lane)


def test_a_file_is_a_lane_of_its_own_unless_it_shares() -> None:
    """The longest beginning counts."""
    assert lane_of("tests/cluster/test_cli.py::test_a[x]") == "tests/cluster/test_cli.py"
    assert lane_of("tests/cluster/network/test_multus.py::test_a") == "network"
    assert lane_of("tests/cluster/network/test_own_cluster.py::test_a") == "own cluster"


def test_what_needs_no_cluster_fills_the_gaps_at_the_end() -> None:
    """The longest lanes come first."""
    pods, cluster = "tests/ros1/test_a.py::test_a", "tests/cluster/observability/test_a.py::test_a"
    assert turn_of("tests/unit/test_a.py::test_a") < turn_of(cluster) < turn_of(pods)


def test_a_skip_is_expected_where_it_is_listed() -> None:
    """For its reason, and in its tests."""
    listed = EXPECTED[0]

    def skips(nodeid: str, reason: str) -> list[str]:
        longrepr = ("a.py", 1, f"Skipped: {reason}")
        report = SimpleNamespace(nodeid=nodeid, longrepr=longrepr)
        return find_unexpected({"skipped": [report]})

    assert skips(f"{listed.tests}::test_a", listed.reason) == []
    assert skips(f"{listed.tests}::test_a", "no such tool") == [
        f"{listed.tests}::test_a: no such tool"
    ]
    assert skips("tests/unit/test_a.py::test_a", listed.reason) != []

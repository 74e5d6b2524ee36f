"""How the tests themselves are run: lanes, their order, and the skips that a run may have."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from ..lanes import LANES, lane_of, turn_of
from ..skips import EXPECTED, unexpected

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("start", [*LANES, *(skip.tests for skip in EXPECTED)])
def test_what_is_named_is_there(start: str) -> None:
    """A file that was moved takes its lane and its skips along."""
    assert (ROOT / start).exists()


def test_a_file_is_a_lane_of_its_own_unless_it_shares() -> None:
    """The longest beginning counts."""
    assert lane_of("tests/cluster/test_cli.py::test_a[x]") == "tests/cluster/test_cli.py"
    assert lane_of("tests/cluster/network/test_multus.py::test_a") == "network"
    assert lane_of("tests/cluster/network/test_own_cluster.py::test_a") == "own clusters"


def test_what_needs_no_program_comes_first_where_none_is_built() -> None:
    """Otherwise the longest lane does, and what needs no cluster fills the gaps at the end."""
    pods, cluster = "tests/ros1/test_a.py::test_a", "tests/cluster/observability/test_a.py::test_a"
    assert turn_of(cluster, built=True) < turn_of(pods, built=True)
    assert turn_of(pods, built=False) < turn_of(cluster, built=False)


def test_a_skip_is_expected_where_it_is_listed() -> None:
    """For its reason, and in its tests."""
    listed = EXPECTED[0]

    def skips(nodeid: str, reason: str) -> list[str]:
        longrepr = ("a.py", 1, f"Skipped: {reason}")
        report = SimpleNamespace(nodeid=nodeid, longrepr=longrepr)
        return unexpected({"skipped": [report]})

    assert skips(f"{listed.tests}::test_a", listed.reason) == []
    assert skips(f"{listed.tests}::test_a", "no such tool") == [
        f"{listed.tests}::test_a: no such tool"
    ]
    assert skips("tests/unit/test_a.py::test_a", listed.reason) != []

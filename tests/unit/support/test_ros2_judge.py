"""What tests and benches of ROS 2's hand-over take for lost or doubled, by texts of few lines."""

from __future__ import annotations

import pytest

from tests.support.ros2_work.judge import judge

CALLER = """
1.00 map v1
1.00 chat v1 7
1.05 chat v1 8
1.06 call 1 v1 3.5
1.08 goal 1 sent
1.09 goal 1 accepted
1.10 chat v1 9
1.16 chat v2 2
1.16 map v2
1.17 call 2 v2 80.0
1.20 chat v2 3
3.08 goal 1 succeeded
"""
WORKERS = """
1.06 v1 call 1
1.08 v1 begin 1
1.10 v1 count 41
1.12 v1 count 42
1.17 v2 call 2
1.18 v2 count 43
3.08 v1 end 1
"""


def test_a_hand_over_without_a_fault() -> None:
    """The gap is between the last message of the old one and the first of the new one."""
    found = judge(CALLER, WORKERS)
    assert found.faults == {}
    assert found.gaps == (pytest.approx(0.06),)
    assert (found.versions, found.maps) == (("v1", "v2"), ("v1", "v2"))
    assert (found.calls, found.slowest, found.goals, found.counted) == (2, 80.0, 1, 3)
    assert found.longest == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("caller", "workers", "faults"),
    [
        ("1.18 chat v1 10", "", {"late": 1}),
        ("1.19 chat v2 2", "", {"doubled": 1}),
        ("1.30 chat v2 6", "", {"missing": 2}),
        ("6.30 call 3 lost", "", {"calls_lost": (3,)}),
        ("", "1.07 v2 call 1", {"calls_twice": (1,)}),
        ("1.20 goal 2 refused", "", {"goals_lost": (2,)}),
        ("1.20 goal 2 status-5", "", {"goals_lost": (2,)}),
        ("1.20 goal 2 lost", "", {"goals_lost": (2,)}),
        ("", "1.09 v2 begin 1", {"goals_twice": (1,)}),
        ("", "1.19 v2 count 42", {"counted_twice": (42,)}),
        ("", "1.19 v2 count 45", {"uncounted": (44,)}),
        ("1.20 map v2", "", {"maps": ("v1", "v2", "v2")}),
        ("1.30 chat v3 1", "", {"maps": ("v1", "v2")}),
        ("1.00 call 0 lost", "", {}),  # before they had found each other
    ],
)
def test_each_fault(caller: str, workers: str, faults: dict[str, object]) -> None:
    """One line more is one fault."""
    assert judge(f"{CALLER}{caller}\n", f"{WORKERS}{workers}\n").faults == faults


@pytest.mark.parametrize("lost", ["1.00 map v1\n", "1.16 map v2\n"])
def test_maps_before_the_lines_begin(lost: str) -> None:
    """The first version's may be among them; that of a later one may not be missing."""
    found = judge(CALLER.replace(lost, ""), WORKERS)
    assert found.faults == ({} if "v1" in lost else {"maps": ("v1",)})


def test_what_others_print_is_not_read() -> None:
    """Warnings of ROS, and lines that were cut off."""
    found = judge(f"{CALLER}[WARN] [1.2] [caller]: chat v1 8\n1.3\n", WORKERS)
    assert found == judge(CALLER, WORKERS)


def test_nothing_was_heard() -> None:
    assert judge("", "").faults == {}

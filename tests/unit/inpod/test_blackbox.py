"""Which bags are kept around a fault, and what a fault is."""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

NOW = 1_000_000.0
RATE = 'ros_topic_as_expected{topic="/scan",expectation="rate"}'
NODE = 'ros_node_up{ros_node="/camera",workload="camera"}'
AGAIN = 'ros_node_restarts_total{ros_node="/camera",workload="camera"}'
GUEST = 'ros_node_up{ros_node="/guest",workload=""}'


class Kind:
    """A folder of bags."""

    unmarked = ("closed",)

    def __init__(self, *bags: tuple[float | None, float, str]) -> None:
        self.kept: dict[float, str] = {}
        self.there = [self.make(*bag) for bag in bags]

    def make(self, started: float | None, ended: float, state: str) -> Any:
        bag = SimpleNamespace(started=started, ended=ended, state=state)
        bag.remove = lambda: self.there.remove(bag)
        return bag

    def bags(self) -> list[Any]:
        return list(self.there)

    def keep(self, bag: Any, why: str) -> None:
        self.kept[bag.ended] = bag.state = why

    @property
    def ends(self) -> list[float]:
        return [bag.ended for bag in self.there]


@pytest.fixture
def blackbox(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("blackbox")


def make_faults(blackbox: ModuleType, *kinds: str) -> Any:
    """Faults that are not asked for; what is printed is in `lines`."""
    lines: list[str] = []
    made = blackbox.Faults(kinds or ("breach", "crash"), "nowhere.invalid:1", lines.append)
    made.lines = lines
    return made


def settle(blackbox: ModuleType, monkeypatch: pytest.MonkeyPatch, kind: Kind, faults: Any) -> None:
    """Settle at NOW, in a box that began 1,000 s before, with 60 s around a fault."""
    monkeypatch.setattr(blackbox, "time", SimpleNamespace(time=lambda: NOW - 1000))
    box = blackbox.BlackBox(kind, 60, faults)
    monkeypatch.setattr(blackbox, "time", SimpleNamespace(time=lambda: NOW))
    monkeypatch.setattr(faults, "ask", lambda now: None)
    box.settle()


def test_a_fault_is_what_was_good_and_is_not(blackbox: ModuleType) -> None:
    """One that lasts is one; what was bad at first, and what is not known, is none."""
    faults = make_faults(blackbox)
    for when, text in enumerate((f"{RATE} 0", f"{RATE} 1\n{NODE} 1", f"{RATE} 0", f"{RATE} 0")):
        faults.take(text, when)
    faults.take("", 5)
    faults.take(f"{RATE} 0\n{NODE} 1.0", 6)
    faults.take(f"{RATE} 1\n{NODE} 0", 7)
    faults.take(f"{RATE} 0.0\n{NODE} 0", 8)
    assert list(faults.found) == [(2, "breach"), (7, "crash"), (8, "breach")]
    assert faults.lines[1] == f"[rigel-k8s] crash: {NODE}"


def test_a_node_that_was_started_again_has_crashed(blackbox: ModuleType) -> None:
    """Also if it was up at each look. A counter that begins again has not counted."""
    faults = make_faults(blackbox)
    for when, count in enumerate((2, 2, 3, 0, 0, 1)):
        faults.take(f"{AGAIN} {count}\n{NODE} 1", when)
    assert list(faults.found) == [(2, "crash"), (5, "crash")]


def test_an_exporter_that_has_just_begun_reports_no_fault(blackbox: ModuleType) -> None:
    """All nodes are down until its first look."""
    faults = make_faults(blackbox)
    faults.take(f"{NODE} 1\nprocess_start_time_seconds 1", 1)
    faults.take(f"{NODE} 0\nprocess_start_time_seconds 2", 2)
    assert not faults.found


def test_faults_of_other_kinds_and_of_others_nodes_are_none(blackbox: ModuleType) -> None:
    faults = make_faults(blackbox, "crash")
    faults.take(f"{RATE} 1\n{GUEST} 1", 1)
    faults.take(f"{RATE} 0\n{GUEST} 0", 2)
    assert not faults.found


def test_an_exporter_that_does_not_answer_is_no_fault(blackbox: ModuleType) -> None:
    """It is printed once, until it answers again."""
    faults = make_faults(blackbox)
    faults.take(f"{NODE} 1", 1)
    faults.ask(10)
    faults.ask(20)
    assert not faults.found
    assert len(faults.lines) == 1
    assert "the exporter does not answer" in faults.lines[0]


def test_bags_around_a_fault_are_kept_and_old_ones_deleted(
    blackbox: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fault is seen up to LATE seconds after it began."""
    starts = range(-780, 0, 60)
    kind = Kind(*((NOW + start, NOW + start + 60, "closed") for start in starts))
    faults = make_faults(blackbox)
    faults.found.append((NOW - 450, "breach"))
    settle(blackbox, monkeypatch, kind, faults)
    assert {end - NOW for end in kind.kept} == {-540, -480, -420, -360}
    assert set(kind.kept.values()) == {"breach"}
    young = [-60, 0]
    assert [end - NOW for end in kind.ends] == [-540, -480, -420, -360, *young]


def test_bags_that_it_did_not_begin_are_not_touched(
    blackbox: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of an earlier start, repaired ones, the newest one, and what is being written."""
    others = [
        (NOW - 1001, NOW - 900, "closed"),
        (NOW - 800, NOW - 700, "repaired"),
        (NOW - 600, NOW - 500, "recording"),
    ]
    kind = Kind(*others, (None, NOW - 400, "closed"), (NOW - 300, NOW - 299, "closed"))
    settle(blackbox, monkeypatch, kind, make_faults(blackbox))
    assert [end - NOW for end in kind.ends] == [-900, -700, -500, -299]

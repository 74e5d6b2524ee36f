"""How often a node must publish: what the keeper measures, and what the probe makes of it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

INF = float("inf")


@pytest.fixture
def rates(script: Callable[[str], ModuleType]) -> ModuleType:
    return script("rates")


@pytest.fixture
def published(rates: ModuleType, monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """What a node has published on each topic; a test changes it."""
    counts: dict[str, int] = {}

    def read(_: str) -> list[SimpleNamespace]:
        node = {"ended": False, "helper": False}
        ends = [
            SimpleNamespace(
                kind="publisher", name=name, count=count // 2, dropped=count - count // 2
            )
            for name, count in counts.items()
        ]
        return [SimpleNamespace(**node, entities=ends)]

    monkeypatch.setattr(rates, "rmw_notes", SimpleNamespace(read_all=read))
    return counts


def measure(made: Any, published: dict[str, int], topic: str, rate: float, seconds: float) -> None:
    """Let a node publish at a rate for a time, and a keeper look meanwhile."""
    before, begun = published.get(topic, 0), made.due
    for step in range(int(seconds / 0.5) + 1):
        published[topic] = before + int(rate * step / 2)
        made.look(begun + step / 2)


def test_the_words_of_the_variable(rates: ModuleType) -> None:
    found = rates.parse("/scan=8:12 /odom=20:inf")
    assert found == {"/scan": (8, 12), "/odom": (20, INF)}
    assert rates.parse("") == {}


def test_without_limits_nothing_is_measured(rates: ModuleType, tmp_path: Path) -> None:
    """And a keeper has nothing to wake for."""
    made = rates.Rates(str(tmp_path), {})
    assert (made.met, made.due) == (True, INF)


def test_a_rate_is_met_once_it_was_measured(
    rates: ModuleType, published: dict[str, int], tmp_path: Path
) -> None:
    """What a node that waits does not get out counts, too."""
    limits = {"/scan": (8.0, 12.0)}
    made = rates.Rates(str(tmp_path), limits)
    assert rates.explain(str(tmp_path), limits) == "the rate of /scan is not known yet"
    measure(made, published, "/scan", 10, 1)
    assert not made.met
    measure(made, published, "/scan", 10, 4)
    assert made.met
    assert rates.explain(str(tmp_path), limits) is None
    measure(made, published, "/scan", 5, 4)
    assert not made.met
    line = "/scan is published 5 times per second, not 8..12/s"
    assert rates.explain(str(tmp_path), limits) == line
    measure(made, published, "/scan", 0, 4)
    measure(made, published, "/scan", 20, 4)
    assert not made.met, "too fast is not as it must be, either"


def test_a_slow_topic_is_measured_for_longer(
    rates: ModuleType, published: dict[str, int], tmp_path: Path
) -> None:
    """One message more or less must not decide."""
    made = rates.Rates(str(tmp_path), {"/map": (0.5, INF)})
    measure(made, published, "/map", 0, 9)
    assert not made._found
    measure(made, published, "/map", 1, 12)
    assert made.met


def test_another_process_begins_to_count_again(
    rates: ModuleType, published: dict[str, int], tmp_path: Path
) -> None:
    """A restart in the same container is not a negative rate."""
    made = rates.Rates(str(tmp_path), {"/scan": (8.0, INF)})
    measure(made, published, "/scan", 100, 4)
    published["/scan"] = 0
    measure(made, published, "/scan", 10, 4)
    assert made.met
    assert made._found["/scan"] == pytest.approx(10, abs=1)


def test_what_no_one_measures_any_more_breaks_nothing(rates: ModuleType, tmp_path: Path) -> None:
    """No reading is not silence."""
    limits = {"/scan": (8.0, INF)}
    path = tmp_path / rates.FILE
    path.write_text("/scan 1\n")
    assert rates.explain(str(tmp_path), limits) == (
        "/scan is published 1 times per second, not 8/s or more"
    )
    os.utime(path, (1.0, 1.0))
    assert rates.explain(str(tmp_path), limits) is None

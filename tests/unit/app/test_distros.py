"""Which ROS a distribution is."""

from __future__ import annotations

from datetime import date

import pytest

from rigel_k8s.app.checks.application import check
from rigel_k8s.app.generation import GENERATIONS, generation_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.rigelfile import render_starter
from rigel_k8s.ros import CURRENT, DISTROS_1, DISTROS_2, find_end


@pytest.mark.parametrize("distro", ["kinetic", "melodic", "noetic", "Noetic", "our-own"])
def test_ros1(distro: str) -> None:
    """Noetic and older, and what only its user knows."""
    assert generation_of(distro).name == "1"


@pytest.mark.parametrize("distro", ["humble", "jazzy", "kilted", "lyrical", "rolling"])
def test_ros2(distro: str) -> None:
    """Every distribution of ROS 2."""
    assert generation_of(distro).name == "2"


@pytest.mark.parametrize(("distro", "name"), [("noetik", "noetic"), ("humbel", "humble")])
def test_a_misspelt_distribution_is_told(distro: str, name: str) -> None:
    """It would be taken for a ROS 1 of the user's own."""
    found = [p for p in check(OrchestrationOptions(), distro) if p.kind == "unknown-distro"]
    assert [p.severity for p in found] == ["warning"]
    assert f'"{name}"' in found[0].message


@pytest.mark.parametrize("distro", ["noetic", "jazzy", "our-own"])
def test_a_known_distribution_and_ones_own_are_no_mistake(distro: str) -> None:
    """No warning without a reason."""
    assert not [p for p in check(OrchestrationOptions(), distro) if p.kind == "unknown-distro"]


@pytest.mark.parametrize(
    ("distro", "newer"), [("iron", "lyrical"), ("Foxy", "lyrical"), ("melodic", "noetic")]
)
def test_a_distribution_past_its_end_is_a_warning(distro: str, newer: str) -> None:
    """It names the day, and what to move to."""
    (found,) = [p for p in check(OrchestrationOptions(), distro) if p.kind == "ended-distro"]
    assert found.severity == "warning"
    assert str({**DISTROS_1, **DISTROS_2}[distro.lower()]) in found.message
    assert found.message.endswith(f"move to {newer}")


@pytest.mark.parametrize("distro", ["noetic", "humble", "rolling", "lyrical", "our-own"])
def test_a_supported_distribution_and_the_last_ros1_are_no_warning(distro: str) -> None:
    """noetic has ended, too, but there is no newer ROS 1."""
    assert not [p for p in check(OrchestrationOptions(), distro) if p.kind == "ended-distro"]


def test_the_last_day_is_a_day_of_support() -> None:
    """A distribution has ended on the day after."""
    assert find_end("kilted", date(2026, 12, 31)) is None
    assert find_end("kilted", date(2027, 1, 1)) == date(2026, 12, 31)


def test_the_current_distribution_comes_first() -> None:
    """It is what `rigel init` writes."""
    assert next(iter(DISTROS_2)) == CURRENT
    assert f"distro: {CURRENT}\n" in render_starter(GENERATIONS["2"].starter)

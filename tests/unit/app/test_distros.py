"""Which ROS a distribution is."""

from __future__ import annotations

import pytest

from rigel_k8s.app.checks.application import check
from rigel_k8s.app.distros import is_ros1
from rigel_k8s.app.options import OrchestrationOptions


@pytest.mark.parametrize("distro", ["kinetic", "melodic", "noetic", "Noetic", "our-own"])
def test_ros1(distro: str) -> None:
    """Noetic and older, and what only its user knows."""
    assert is_ros1(distro)


@pytest.mark.parametrize("distro", ["humble", "jazzy", "kilted", "lyrical", "rolling"])
def test_ros2(distro: str) -> None:
    """Every distribution of ROS 2."""
    assert not is_ros1(distro)


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

"""Three implementations of DDS that share no code, each hearing the others over one wire."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from .conftest import deployer

pytestmark = pytest.mark.cluster

TALKERS = {"fast_talker", "cyclone_talker", "rust_talker"}


@pytest.fixture(scope="module")
def interop(project: Callable[..., Any], ros2_image: str, interop_image: str, multus: None) -> Any:
    """tests/images/interop as it is: three talkers and three listeners over macvlan."""
    return deployer(project, ros2_image)()


def test_the_talkers_and_listeners_are_on_three_machines(interop: Any) -> None:
    """So that what is heard has crossed the wire."""
    machines = interop.project.machines()
    assert len(set(machines.values())) == 3
    for kind, others in (("fast", "cyclone"), ("cyclone", "rust"), ("rust", "cyclone")):
        assert machines[f"{kind}-listener"] != machines[f"{others}-talker"]


@pytest.mark.parametrize("listener", ["fast_listener", "cyclone_listener", "rust_listener"])
def test_each_hears_all_three(interop: Any, listener: str) -> None:
    """rclpy on Fast DDS, Cyclone DDS and RustDDS understand each other without further options."""
    interop.until_heard(listener, TALKERS)

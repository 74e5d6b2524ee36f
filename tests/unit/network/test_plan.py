"""What is the same for all pods of a release: its domain, its middleware."""

from __future__ import annotations

import pytest

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.network.options import Network, middleware_name, network_of
from rigel_k8s.network.plan import network_plan
from rigel_k8s.network.wiring import NetworkPlan


def plan(told: Network | str | None, release: str = "demo", ros: str = "2") -> NetworkPlan:
    return network_plan(
        network_of(told),
        namespace="robots",
        release=release,
        ros=GENERATIONS[ros],
        distro="jazzy",  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(("mode", "expected"), [("host", True), ("macvlan", False), (None, False)])
def test_pods_share_the_machines_address_in_mode_host(mode: str | None, expected: bool) -> None:  # noqa: FBT001
    """There, Fast DDS of a pod shares memory with the whole machine, or with none."""
    assert plan(mode).on_machine == expected


@pytest.mark.parametrize("mode", ["macvlan", "attachment", "host"])
def test_where_laptops_are_the_domain_is_theirs(mode: str) -> None:
    """A laptop on the same Ethernet uses domain 0 unless told, and so do pods on it."""
    assert plan(mode).domain_id == 0


@pytest.mark.parametrize("mode", ["peers", "discovery-server", "zenoh"])
def test_over_the_pod_network_a_release_has_a_domain_of_its_own(mode: str) -> None:
    """It is safe, always the same, and hardly ever another release's."""
    found = [plan(mode, f"release-{number}").domain_id for number in range(300)]
    assert found == [plan(mode, f"release-{number}").domain_id for number in range(300)]
    assert set(found) <= set(range(1, 102))
    assert len(set(found)) > 80


def test_what_is_told_wins() -> None:
    """A domain that the Rigelfile names is that domain, 0 too."""
    assert plan(Network(mode="peers", domain_id=0)).domain_id == 0
    assert plan(Network(mode="macvlan", domain_id=42)).domain_id == 42


def test_a_plain_dds_application_says_its_domain_itself() -> None:
    """No variable would change its domain, so nobody looks for it in one that nobody told."""
    assert plan("peers", ros="none").domain_id is None


@pytest.mark.parametrize(
    ("told", "word"),
    [
        ("rmw_fastrtps_cpp", "fastdds"),
        ("rmw_cyclonedds_cpp", "cyclonedds"),
        ("rmw_zenoh_cpp", "zenoh"),
        ("zenoh", "zenoh"),
        (None, None),
    ],
)
def test_a_middleware_has_two_names(told: str | None, word: str | None) -> None:
    """ROS' name of an RMW means the same as the word."""
    assert middleware_name(told) == word

"""Ranges are taken from what the machine leaves free."""

from __future__ import annotations

import ipaddress

import pytest

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster.addresses import Addresses, find_free_block, networks
from rigel_lab.cluster.network import hardware_address


def free(*used: str) -> str:
    return find_free_block(map(ipaddress.IPv4Network, used)).block


def test_first_choice() -> None:
    """On a machine without private networks it is 10.64.0.0/14."""
    assert free("192.0.2.0/24") == "10.64.0.0/14"


@pytest.mark.parametrize(
    ("used", "block"),
    [
        (["10.64.0.0/16"], "10.68.0.0/14"),  # a part of the block is enough
        (["10.67.255.255/32"], "10.68.0.0/14"),
        (["10.64.0.0/10"], "10.128.0.0/14"),
        (["10.0.0.0/8"], "172.16.0.0/14"),  # a company's VPN
        (["10.0.0.0/8", "172.16.0.0/12"], "100.64.0.0/14"),
    ],
)
def test_what_is_used_is_avoided(used: list[str], block: str) -> None:
    """A block overlaps no network in use."""
    assert free(*used) == block


def test_everything_used_is_told() -> None:
    """Where nothing is free the error says so."""
    with pytest.raises(LocalClusterError, match="no free address range"):
        free("10.0.0.0/8", "172.16.0.0/12", "100.64.0.0/10")


def test_parts_do_not_overlap() -> None:
    """Pods, services and machines are three networks of the block."""
    addresses = Addresses("10.64.0.0/14")
    assert addresses.pods == "10.64.0.0/16"
    assert addresses.services == "10.65.0.0/16"
    assert str(addresses.machines) == "10.66.0.0/24"
    assert addresses.machine(2) == "10.66.0.2"
    assert addresses.pod_range("node2") == "10.64.2.0/24"
    assert (addresses.api_service, addresses.dns_service) == ("10.65.0.1", "10.65.0.10")


def test_lines_that_are_no_network_are_passed_over() -> None:
    """`default`, host names and IPv6 in routes and name servers are no IPv4 network."""
    found = networks(["default", "10.1.2.3", "fd00::1", "10.2.0.0/16", "10.3.0.9/24", "dns"])
    assert list(map(str, found)) == ["10.1.2.3/32", "10.2.0.0/16", "10.3.0.0/24"]


def test_a_machine_started_again_has_the_same_hardware_address() -> None:
    """It follows from the address, so nobody's neighbour table is wrong after a restart."""
    assert hardware_address("10.66.0.11") == "02:52:0a:42:00:0b"

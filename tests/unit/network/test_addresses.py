"""`ipam: static`: an address for each workload, its own for as long as it lives."""

from __future__ import annotations

from ipaddress import IPv4Interface
from itertools import permutations

import pytest

from rigel_k8s.network.addresses import Pool, assign, read_addresses
from rigel_k8s.network.options import Network

from ..app.shapes import find, release
from .shapes import revision

NAMES = ["talker", "listener", "camera", "ros-master"]


def network(**more: object) -> Network:
    return Network(**{"subnet": "10.20.0.0/28", "ipam": "static", **more})  # type: ignore[arg-type]


def test_each_workload_has_an_address_of_its_own_in_the_range() -> None:
    """They differ, lie in the range, and carry the subnet's prefix length."""
    told = network(range_start="10.20.0.4", range_end="10.20.0.9", exclude=["10.20.0.6/31"])
    found = [IPv4Interface(item) for item in assign(told, NAMES, {}).values()]
    assert {str(item.ip) for item in found} == {f"10.20.0.{n}" for n in (4, 5, 8, 9)}
    assert {item.network.prefixlen for item in found} == {28}


def test_addresses_are_derived_from_names_alone() -> None:
    """The order in which nodes are written changes nothing."""
    wanted = assign(network(), NAMES, {})
    for order in permutations(NAMES):
        assert assign(network(), order, {}) == wanted


def test_who_had_an_address_keeps_it() -> None:
    """Others that come and go, before or behind in the alphabet, take nobody's address."""
    first = assign(network(), NAMES, {})
    second = assign(network(), [*NAMES, "a", "b", "zebra"], first)
    assert second.items() >= first.items()
    third = assign(network(), ["talker", "zebra", "young"], second)
    assert {name: third[name] for name in ("talker", "zebra")} == {
        name: second[name] for name in ("talker", "zebra")
    }


@pytest.mark.parametrize(
    "narrower",
    [{"range_start": "10.20.0.9"}, {"exclude": ["10.20.0.0/29"]}, {"gateway": "10.20.0.5"}],
)
def test_an_address_that_the_network_lacks_now_is_given_up(narrower: dict[str, object]) -> None:
    """An address out of the range, excluded, or the gateway's own is replaced."""
    found = assign(network(**narrower), ["talker"], {"talker": "10.20.0.5/28"})
    assert found["talker"] != "10.20.0.5/28"


def test_two_that_had_one_address_part() -> None:
    """An annotation that somebody wrote by hand gives no address twice."""
    found = assign(network(), ["a", "b"], {"a": "10.20.0.5/28", "b": "10.20.0.5/28"})
    assert found["a"] == "10.20.0.5/28" != found["b"]


def test_too_few_addresses_are_told() -> None:
    """Nobody goes without, or shares."""
    with pytest.raises(ValueError, match="none is left for zebra"):
        assign(network(range_start="10.20.0.14"), ["ape", "zebra"], {})


@pytest.mark.parametrize(
    ("more", "count"),
    [
        ({}, 14),
        ({"gateway": "10.20.0.1"}, 13),
        ({"exclude": ["10.20.0.4/30", "10.20.0.5", "10.99.0.0/16"]}, 10),
        ({"range_start": "10.20.0.0", "range_end": "10.20.0.15"}, 14),
        ({"range_start": "10.20.0.8", "exclude": ["10.20.0.0/28"]}, 0),
    ],
)
def test_a_pool_counts_what_it_has(more: dict[str, object], count: int) -> None:
    """What it counts is what it gives out."""
    pool = Pool(network(**more))
    given_out = set(pool.iterate_from(123456789))
    assert len(pool) == count == len(given_out)
    stretches = [range(first, last + 1) for first, last in pool.stretches]
    assert [n for stretch in stretches for n in stretch] == sorted(map(int, given_out))


def test_a_large_range_is_not_walked_through() -> None:
    """The addresses of a /8 are counted without looking at each."""
    assert len(Pool(network(subnet="10.0.0.0/8"))) == 2**24 - 2


def test_addresses_are_read_from_what_was_deployed() -> None:
    """A revision's objects tell who has which address; what others wrote there does no harm."""
    strange = revision("b", "10.20.0.6")
    strange["spec"]["template"]["metadata"]["annotations"]["rigel-k8s/network"] = "{"
    service = {"kind": "Service", "metadata": {"name": "talker"}, "spec": {}}
    objects = [revision("a", "10.20.0.5"), strange, service]
    assert read_addresses(objects) == {"a": "10.20.0.5"}


WITH = """\
nodes: {{talker: {{image: a}}, {more}}}
network: {{interface: eth0, subnet: 10.20.0.0/28, ipam: static}}
"""


def test_a_deployed_release_tells_the_next_one() -> None:
    """From the objects of one revision the next one gives the same addresses."""
    first = release(WITH.format(more="zebra: {image: a}"), distro="jazzy")
    had = read_addresses(first.objects)
    assert set(had) == {"talker", "zebra"}
    text = WITH.format(more="ape: {image: a}, zebra: {image: a}")
    second = release(text, distro="jazzy", previous=first.objects)
    assert read_addresses(second.objects).items() >= had.items()
    for name in had:
        pods = [find(made, "Deployment", name)["spec"]["template"] for made in (first, second)]
        assert pods[0] == pods[1]

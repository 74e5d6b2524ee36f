"""Checks of the addresses in `network`; no machine is asked whether it has them."""

from __future__ import annotations

from collections.abc import Iterator
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network

from rigel_k8s.network.addresses import Pool
from rigel_k8s.network.options import Network
from rigel_k8s.problems import Path, Problem

KIND = "bad-range"
#: A subnet with fewer addresses than this has none to give out.
SMALLEST = 4


def check_ranges(network: Network) -> Iterator[Problem]:
    """Yield invalid addresses, and addresses in the wrong place."""
    subnet = read_network(network.subnet)
    if network.subnet is not None and subnet is None:
        yield problem_at("subnet", explain_invalid(network.subnet))
    elif subnet is not None:
        yield from check_subnet(network.subnet or "", subnet)
        yield from check_inside(network, subnet)
    for index, route in enumerate(network.routes):
        if read_network(route) is None:
            yield problem_at(("routes", index), explain_invalid(route))
    if network.routes and network.gateway is None:
        yield problem_at(
            "routes", "routes need a gateway: set `gateway`", kind="incomplete", at_key=True
        )


def problem_at(key: str | Path, message: str, *, kind: str = KIND, at_key: bool = False) -> Problem:
    """Return a problem of one of the network's keys."""
    path = (key,) if isinstance(key, str) else key
    return Problem(("network", *path), message, kind, at_key=at_key)


def check_subnet(text: str, subnet: IPv4Network) -> Iterator[Problem]:
    """Yield what is wrong with a subnet."""
    address = text.partition("/")[0]
    if IPv4Address(address) != subnet.network_address:
        yield problem_at("subnet", f"{address} is an address within it; the subnet is {subnet}")
    if subnet.num_addresses < SMALLEST:
        yield problem_at("subnet", f"{subnet} has no addresses to give out; a /24 has 254")


def check_inside(network: Network, subnet: IPv4Network) -> Iterator[Problem]:
    """Yield invalid single addresses, and those outside of the subnet."""
    ends = {}
    for key in ("range_start", "range_end", "gateway"):
        text = getattr(network, key)
        address = read_address(text)
        if text is not None and address is None:
            yield problem_at(
                key, f'"{text}" is not an IPv4 address such as {subnet.network_address + 1}'
            )
        elif address is not None and address not in subnet:
            yield problem_at(key, f"{address} is not in {subnet}")
        else:
            ends[key] = address
    first, last = ends.get("range_start"), ends.get("range_end")
    if first is not None and last is not None and first > last:
        yield problem_at("range_end", f"the range ends before it starts ({first})")
    for index, item in enumerate(network.exclude):
        yield from check_excluded(index, item, subnet)


def check_excluded(index: int, item: str, subnet: IPv4Network) -> Iterator[Problem]:
    """Yield why an exclusion excludes nothing."""
    found = read_network(item)
    if found is None:
        yield problem_at(("exclude", index), explain_invalid(item))
    elif not found.overlaps(subnet):
        message = f"it excludes nothing: no address of {subnet} is in it"
        yield Problem(("network", "exclude", index), message, KIND, severity="warning")


def pool_of(network: Network) -> Pool | None:
    """Return the addresses to give out, None if the options have no valid range."""
    if network.subnet is None or any(p.severity == "error" for p in check_ranges(network)):
        return None
    return Pool(network)


def explain_invalid(text: str) -> str:
    """Return why a text is not a range of IPv4 addresses."""
    if read_v6(text):
        return f'"{text}" is IPv6, which is not supported for DDS; use an IPv4 range'
    return f'"{text}" is not a range of IPv4 addresses such as 10.20.0.0/24'


def read_network(text: str | None) -> IPv4Network | None:
    """Return a range, or None; a single address is a range of one."""
    try:
        return IPv4Network(text or "", strict=False)
    except ValueError:
        return None


def read_address(text: str | None) -> IPv4Address | None:
    """Return an address, or None."""
    try:
        return IPv4Address(text or "")
    except ValueError:
        return None


def read_v6(text: str) -> IPv6Network | IPv6Address | None:
    """Return what a text is in IPv6, or None."""
    try:
        return IPv6Network(text, strict=False)
    except ValueError:
        return None

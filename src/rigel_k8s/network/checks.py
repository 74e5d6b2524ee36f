"""Checks of the options of `network` that hold for any cluster; pure.

preflight/ checks before a deploy whether the cluster has what a mode needs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network

import attrs

from rigel_k8s.network.addresses import Pool
from rigel_k8s.network.mode import ModeUse, mode_path
from rigel_k8s.network.modes import MODES, mode_of
from rigel_k8s.network.options import Install, Network
from rigel_k8s.objects.text import join_words
from rigel_k8s.problems import Path, Problem
from rigel_k8s.ros import Ros

#: Options that have an effect only if addresses are given out by these options.
OF_RANGES = ("subnet", "range_start", "range_end", "exclude", "gateway", "routes")

#: The last domain, and those whose ports Linux gives to any program (32768 to 60999).
LAST_DOMAIN, UNSAFE = 232, range(102, 215)
LONGEST_INTERFACE = 15
#: A subnet with fewer addresses than this has none to give out.
SMALLEST = 4


def check_options(network: Network, use: ModeUse) -> Iterator[Problem]:
    """Yield what is wrong, with paths from the root of the job's options."""
    mode = mode_of(network)
    if meant := guess_mode(network):
        message = f"only `mode: {meant}` reads {join_words(own_keys(network))}: add it"
        yield Problem(("network",), message, "incomplete", at_key=True)
        return
    if network.domain_id is not None and network == Network(domain_id=network.domain_id):
        message = f"{mode.name}, the mode by default, needs `interface` and `subnet`: add them, or"
        yield Problem(("network",), f"{message} another `mode`", "incomplete", at_key=True)
        return
    yield from check_keys(network)
    yield from check_domain(network, use.ros)
    if not use.ros.dds and not mode.with_master:
        message = f"{mode.name} is for DDS; nodes of {use.ros.title} find each other by a master"
        yield Problem(mode_path(network), message, "ros1")
    if use.middleware == "zenoh" and mode.connects and mode.middleware != "zenoh":
        message = "zenoh finds others through its router, not by DDS: set `network: zenoh`"
        yield Problem(mode_path(network), message, "wrong-mode")
    else:
        yield from mode.check(network, use)
    yield from check_form(network)
    yield from check_ranges(network)


@cache
def index_readers() -> dict[str, list[str]]:
    """Return the options that only some modes read, each with those modes."""
    readers = {
        field.name: [mode.name for mode in MODES.values() if field.name in mode.keys]
        for field in attrs.fields(Network)
    }
    return {key: modes for key, modes in readers.items() if modes}


def check_keys(network: Network) -> Iterator[Problem]:
    """Yield keys that the mode does not read."""
    for key, modes in index_readers().items():
        if not getattr(network, key):
            continue
        if network.mode not in modes:
            message = (
                f"`{key}` is for {join_words(modes)}; {network.mode} does not read it: leave it out"
            )
            yield Problem(("network", key), message, "foreign-key", at_key=True)
        elif key in OF_RANGES and (reason := mode_of(network).explain_unused(network)):
            yield Problem(("network", key), reason, "foreign-key", at_key=True)


def own_keys(network: Network) -> list[str]:
    """Return the options that are set and that only some modes read."""
    return [f"`{key}`" for key in index_readers() if getattr(network, key)]


def guess_mode(network: Network) -> str | None:
    """Return the mode that was forgotten: one mode alone reads all that is set, macvlan nothing."""
    given = {key: modes for key, modes in index_readers().items() if getattr(network, key)}
    common = set(MODES).intersection(*map(set, given.values())) if given else set()
    default = attrs.fields(Network).mode.default
    if network.mode != default or len(common) != 1 or default in common:
        return None
    return common.pop()


def check_domain(network: Network, ros: Ros) -> Iterator[Problem]:
    """Yield domains that do not exist, or whose ports other programs may have."""
    domain = network.domain_id
    if domain is None:
        return
    path = ("network", "domain_id")
    if not ros.dds:
        yield Problem(path, f"{ros.title} has no domains: leave it out", "ros1", at_key=True)
    elif not 0 <= domain <= LAST_DOMAIN:
        yield Problem(path, f"{domain} is not a DDS domain: 0 to {LAST_DOMAIN}", "bad-domain")
    elif domain in UNSAFE:
        message = (
            f"Linux may give the ports of domain {domain} to other programs, and then a node does"
            " not start; 0 to 101 and 215 to 232 are safe"
        )
        yield Problem(path, message, "bad-domain", severity="warning")


def check_form(network: Network) -> Iterator[Problem]:
    """Yield an invalid name of an interface, and contradictions in `install`."""
    name = network.interface
    if name is not None and not re.fullmatch(rf"[^/\s:]{{1,{LONGEST_INTERFACE}}}", name):
        message = f'invalid interface "{name}": at most 15 characters, without space, "/" or ":"'
        yield Problem(("network", "interface"), message, "bad-name")
    if network.install is not None:
        for problem in check_install(network.install):
            yield problem.under(("network", "install"))


def check_install(options: Install) -> Iterator[Problem]:
    """Yield contradictions in the options of an installation, with paths from their root."""
    if options.data_dir and options.platform not in (None, "k3s"):
        message = f"only k3s has a data directory, and this is {options.platform}"
        yield Problem(("data_dir",), message, "no-k3s")


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


def problem_at(
    key: str | Path, message: str, *, kind: str = "bad-range", at_key: bool = False
) -> Problem:
    """Return a problem of one of the network's keys."""
    path = (key,) if isinstance(key, str) else key
    return Problem(("network", *path), message, kind, at_key=at_key)


def check_subnet(text: str, subnet: IPv4Network) -> Iterator[Problem]:
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
        yield Problem(("network", "exclude", index), message, "bad-range", severity="warning")


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

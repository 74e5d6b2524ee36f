"""Checks of the options of `network` that hold for any cluster; pure.

preflight/ checks before a deploy whether the cluster has what a mode needs.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache

import attrs

from rigel_k8s.generation import Generation
from rigel_k8s.network.mode import ModeUse, mode_path
from rigel_k8s.network.modes import MODES, mode_of
from rigel_k8s.network.options import Install, Network
from rigel_k8s.network.rangechecks import check_ranges
from rigel_k8s.objects.text import join_words
from rigel_k8s.problems import Problem

#: Options that have an effect only if addresses are given out by these options.
OF_RANGES = ("subnet", "range_start", "range_end", "exclude", "gateway", "routes")

#: The last domain, and those whose ports Linux gives to any program (32768 to 60999).
LAST_DOMAIN, UNSAFE = 232, range(102, 215)
LONGEST_INTERFACE = 15


def check_options(network: Network, use: ModeUse) -> Iterator[Problem]:
    """Yield what is wrong, with paths from the root of the job's options."""
    mode = mode_of(network)
    yield from check_keys(network)
    yield from check_domain(network, use.ros)
    if not use.ros.dds and not mode.with_master:
        message = f"{mode.name} is for DDS; nodes of {use.ros.title} find each other by a master"
        yield Problem(mode_path(network), message, "ros1")
    if use.middleware == "zenoh" and mode.name not in ("zenoh", "none"):
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
        elif key in OF_RANGES and (reason := explain_unused(network)):
            yield Problem(("network", key), reason, "foreign-key", at_key=True)


def explain_unused(network: Network) -> str | None:
    """Return why the options about addresses have no effect, None if they have one."""
    if network.mode == "attachment" and network.ipam != "static":
        return (
            "the existing attachment decides about addresses; this has an effect only with"
            " `ipam: static`"
        )
    return None


def check_domain(network: Network, ros: Generation) -> Iterator[Problem]:
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

"""NetworkAttachmentDefinitions: which interface, which CNI programs and which addresses."""

from __future__ import annotations

import ipaddress
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.network.preflight.machine import Address, Subnet

API, KIND = "k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition"
#: The kind in which whereabouts records which addresses it has given out.
POOL_API, POOL_KIND = "whereabouts.cni.cncf.io/v1alpha1", "IPPool"

#: Programs that put an interface on top of one of the machine's.
ON_AN_INTERFACE = ("macvlan", "ipvlan")


@attrs.frozen
class Range:
    """Addresses that are given out: from first to last, except the excluded ones."""

    subnet: Subnet
    first: Address
    last: Address
    exclude: tuple[Subnet, ...] = ()

    def gives(self, one: Address) -> bool:
        """Return whether a pod may get this address."""
        if one.version != self.subnet.version or not int(self.first) <= int(one) <= int(self.last):
            return False
        return not any(one in taken for taken in self.exclude)

    @property
    def size(self) -> int:
        """How many addresses there are to give out."""
        taken = sum(self._count_within(one) for one in _collapse(self.exclude))
        return max(0, int(self.last) - int(self.first) + 1 - taken)

    def _count_within(self, one: Subnet) -> int:
        first = max(int(self.first), int(one.network_address))
        return max(0, min(int(self.last), int(one.broadcast_address)) - first + 1)

    def __str__(self) -> str:
        return f"{self.first} to {self.last}"


@attrs.frozen
class Attachment:
    """A second network as Multus reads it.

    Attributes:
        programs: the CNI programs that it runs, that of its addresses included.
        program: the one that makes the interface; "" if the configuration is not in the object.
        master: the machine's interface; None if macvlan takes that of the default route.
        ipam: the program that gives out addresses, "" if there is no such program.
        passes: whether addresses that a pod requests are passed on (capability `ips`).
    """

    namespace: str
    name: str
    program: str = ""
    programs: tuple[str, ...] = ()
    mode: str = ""
    master: str | None = None
    mtu: int = 0
    ipam: str = ""
    ranges: tuple[Range, ...] = ()
    gateway: Address | None = None
    passes: bool = False

    @property
    def key(self) -> str:
        """NAMESPACE/NAME."""
        return f"{self.namespace}/{self.name}"

    @property
    def on_an_interface(self) -> bool:
        """Whether it is put on top of one of the machine's interfaces."""
        return self.program in ON_AN_INTERFACE


def attachment(manifest: Mapping[str, Any]) -> Attachment:
    """Return a NetworkAttachmentDefinition's facts; from an invalid one only a few can be read."""
    meta = manifest["metadata"]
    plain = Attachment(meta.get("namespace", ""), meta["name"])
    plugins = _plugins((manifest.get("spec") or {}).get("config") or "")
    if not plugins:
        return plain
    main, ipam = plugins[0], plugins[0].get("ipam") or {}
    programs = [*(plugin.get("type") for plugin in plugins), ipam.get("type")]
    return attrs.evolve(
        plain,
        program=str(main.get("type", "")),
        programs=tuple(str(name) for name in programs if name),
        mode=str(main.get("mode", "")),
        master=main.get("master") or None,
        mtu=main["mtu"] if isinstance(main.get("mtu"), int) else 0,
        ipam=str(ipam.get("type", "")),
        ranges=tuple(_ranges(ipam)),
        gateway=address(ipam.get("gateway")),
        passes=any((plugin.get("capabilities") or {}).get("ips") is True for plugin in plugins),
    )


def _plugins(config: str) -> list[Mapping[str, Any]]:
    """Return the plugins of a CNI configuration, or of a list of them."""
    try:
        read = json.loads(config)
    except ValueError:
        return []
    if not isinstance(read, dict):
        return []
    plugins = read.get("plugins") if isinstance(read.get("plugins"), list) else [read]
    return [plugin for plugin in plugins or [] if isinstance(plugin, dict)]


def _ranges(ipam: Mapping[str, Any]) -> Iterator[Range]:
    """Yield the ranges of whereabouts (`range`, `ipRanges`) or host-local (`subnet`, `ranges`)."""
    nested = [one for some in ipam.get("ranges") or [] for one in some if isinstance(some, list)]
    for one in [ipam, *(ipam.get("ipRanges") or []), *nested]:
        made = _range(one) if isinstance(one, dict) else None
        if made:
            yield made


def _range(ipam: Mapping[str, Any]) -> Range | None:
    text = str(ipam.get("range") or ipam.get("subnet") or "")
    start, dash, rest = text.partition("-")  # whereabouts: 10.1.0.5-10.1.0.9/24
    whole = subnet(rest if dash else text)
    if whole is None:
        return None
    first, last = find_usable(whole)
    if dash:
        first, last = address(start) or first, address(rest.partition("/")[0]) or last
    exclude = [subnet(one) for one in ipam.get("exclude") or []]
    return Range(
        whole,
        address(ipam.get("range_start") or ipam.get("rangeStart")) or first,
        address(ipam.get("range_end") or ipam.get("rangeEnd")) or last,
        tuple(one for one in exclude if one is not None),
    )


def find_usable(whole: Subnet) -> tuple[Address, Address]:
    """Return the first and last address that a host may have."""
    first, last = whole.network_address, whole.broadcast_address
    return (first + 1, last - 1) if whole.num_addresses > 2 else (first, last)


def subnet(text: object) -> Subnet | None:
    """Return the range that a text contains, None if it is invalid."""
    try:
        return ipaddress.ip_network(str(text), strict=False)
    except ValueError:
        return None


def address(text: object) -> Address | None:
    """Return the address in a text with or without prefix length, None if it is invalid."""
    try:
        return ipaddress.ip_interface(str(text)).ip
    except ValueError:
        return None


def _collapse(subnets: Sequence[Subnet]) -> Iterator[Subnet]:
    """Yield the same addresses, none of them twice."""
    yield from ipaddress.collapse_addresses(s for s in subnets if s.version == 4)
    yield from ipaddress.collapse_addresses(s for s in subnets if s.version == 6)

"""NetworkAttachmentDefinitions: which interface, which CNI programs and which addresses."""

from __future__ import annotations

import ipaddress
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.objects.overlay import list_mappings, parse_json
from rigel_multus.preflight.machine import Address, Subnet

API, KIND = "k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition"
#: The kind in which whereabouts records which addresses it has given out.
POOL_API, POOL_KIND = "whereabouts.cni.cncf.io/v1alpha1", "IPPool"

#: Programs that put an interface on top of one of the machine's.
ON_AN_INTERFACE = ("macvlan", "ipvlan")


@attrs.frozen
class AddressRange:
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
        own = [one for one in self.exclude if one.version == self.subnet.version]
        size = int(self.last) - int(self.first) + 1
        for one in ipaddress.collapse_addresses(own):  # type: ignore[type-var]
            first = max(int(self.first), int(one.network_address))
            last = min(int(self.last), int(one.broadcast_address))
            size -= max(0, last - first + 1)
        return max(0, size)

    def __str__(self) -> str:
        return f"{self.first} to {self.last}"


@attrs.frozen
class AttachmentFacts:
    """A second network as Multus reads it.

    Attributes:
        key: NAMESPACE/NAME.
        programs: the CNI programs that it runs, that of its addresses included.
        program: the one that makes the interface; "" if the configuration is not in the object.
        master: the machine's interface; None if macvlan takes that of the default route.
        ipam: the program that gives out addresses, "" if there is no such program.
    """

    key: str
    program: str = ""
    programs: tuple[str, ...] = ()
    master: str | None = None
    mtu: int = 0
    ipam: str = ""
    ranges: tuple[AddressRange, ...] = ()


def read_attachment(manifest: Mapping[str, Any]) -> AttachmentFacts:
    """Return a NetworkAttachmentDefinition's facts; of an invalid one only its name."""
    meta = manifest["metadata"]
    key = f"{meta.get('namespace', '')}/{meta['name']}"
    config: dict[str, Any] = parse_json((manifest.get("spec") or {}).get("config"), {})
    plugins = list(list_mappings(config.get("plugins", [config] if config else [])))
    if not plugins:
        return AttachmentFacts(key)
    main, ipam = plugins[0], plugins[0].get("ipam") or {}
    programs = [*(plugin.get("type") for plugin in plugins), ipam.get("type")]
    return AttachmentFacts(
        key,
        program=str(main.get("type", "")),
        programs=tuple(str(name) for name in programs if name),
        master=main.get("master") or None,
        mtu=main["mtu"] if isinstance(main.get("mtu"), int) else 0,
        ipam=str(ipam.get("type", "")),
        ranges=tuple(read_ranges(ipam)),
    )


def read_ranges(ipam: Mapping[str, Any]) -> Iterator[AddressRange]:
    """Yield the ranges of whereabouts (`range`, `ipRanges`) or host-local (`subnet`, `ranges`)."""
    nested = [one for some in ipam.get("ranges") or [] for one in some]
    for one in [ipam, *(ipam.get("ipRanges") or []), *nested]:
        text = str(one.get("range") or one.get("subnet") or "")
        start, dash, rest = text.partition("-")  # whereabouts: 10.1.0.5-10.1.0.9/24
        ends = (start, rest.partition("/")[0]) if dash else ("", "")
        made = make_range(
            rest if dash else text,
            one.get("range_start") or one.get("rangeStart") or ends[0],
            one.get("range_end") or one.get("rangeEnd") or ends[1],
            one.get("exclude") or [],
        )
        if made is not None:
            yield made


def make_range(
    text: str, start: str | None, end: str | None, exclude: list[str]
) -> AddressRange | None:
    """Return the addresses of a subnet that a host may have, None if it is invalid."""
    whole = read_subnet(text)
    if whole is None:
        return None
    first, last = whole.network_address, whole.broadcast_address
    if whole.num_addresses > 2:
        first, last = first + 1, last - 1
    taken = tuple(one for one in map(read_subnet, exclude) if one is not None)
    return AddressRange(whole, read_address(start) or first, read_address(end) or last, taken)


def read_subnet(text: object) -> Subnet | None:
    """Return the range that a text contains, None if it is invalid."""
    try:
        return ipaddress.ip_network(str(text), strict=False)
    except ValueError:
        return None


def read_address(text: object) -> Address | None:
    """Return the address in a text with or without prefix length, None if it is invalid."""
    try:
        return ipaddress.ip_interface(str(text)).ip
    except ValueError:
        return None

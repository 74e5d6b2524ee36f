"""Addresses of `ipam: static`: one for each workload, the same for as long as it lives.

A workload that has an address keeps it. The address of a new workload is derived from its name, so
no cluster is needed and two renders agree. Of an object, this module only reads the annotation that
contains the address.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from ipaddress import IPv4Address, IPv4Network, collapse_addresses
from typing import Any

from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NETWORK_ANNOTATION


class Pool:
    """The addresses that may be given out.

    Raises:
        ValueError: the options have no range of addresses; the checks report where and why.
    """

    def __init__(self, network: Network) -> None:
        self.subnet = IPv4Network(network.subnet or "", strict=False)
        lowest, highest = self.subnet.network_address, self.subnet.broadcast_address
        self.first = IPv4Address(network.range_start or lowest)
        self.last = IPv4Address(network.range_end or highest)
        never = [*network.exclude, *filter(None, [network.gateway]), str(lowest), str(highest)]
        networks = (IPv4Network(item, strict=False) for item in never)
        self.reserved = tuple(collapse_addresses(networks))

    def __contains__(self, address: IPv4Address) -> bool:
        """Return whether an address may be given out."""
        inside = self.first <= address <= self.last and address in self.subnet
        return inside and not any(address in network for network in self.reserved)

    def __len__(self) -> int:
        """Return how many there are."""
        return max(0, self._span) - sum(map(self._count_within, self.reserved))

    @property
    def _span(self) -> int:
        return int(self.last) - int(self.first) + 1

    def _count_within(self, network: IPv4Network) -> int:
        """Return how many addresses of a network lie between the first and the last."""
        start = max(int(self.first), int(network.network_address))
        end = min(int(self.last), int(network.broadcast_address))
        return max(0, end - start + 1)

    def stretches(self) -> Iterator[tuple[IPv4Address, IPv4Address]]:
        """Yield (first, last) of each stretch without gaps."""
        start = int(self.first)
        for network in self.reserved:
            if start < int(network.network_address):
                yield from self._stretch(start, int(network.network_address) - 1)
            start = max(start, int(network.broadcast_address) + 1)
        yield from self._stretch(start, int(self.last))

    def _stretch(self, start: int, end: int) -> Iterator[tuple[IPv4Address, IPv4Address]]:
        """Yield a stretch as far as it lies between the first and the last."""
        end = min(end, int(self.last))
        if start <= end:
            yield IPv4Address(start), IPv4Address(end)

    def iterate_from(self, number: int) -> Iterator[IPv4Address]:
        """Yield all addresses, once each, beginning at any of them."""
        start = int(self.first) + number % max(1, self._span)
        stretches = [(int(first), int(last)) for first, last in self.stretches()]
        for first, last in stretches:
            yield from map(IPv4Address, range(max(first, start), last + 1))
        for first, last in stretches:
            yield from map(IPv4Address, range(first, min(last, start - 1) + 1))


def assign(
    network: Network, names: Iterable[str], previous: Mapping[str, str], salt: str = ""
) -> dict[str, str]:
    """Return each workload's address with its prefix length.

    Args:
        previous: the addresses of the last revision; kept if the network still has them.
        salt: differs between releases that share a network, so their addresses rarely collide.

    Raises:
        ValueError: there are fewer addresses than names, or no range of them.
    """
    pool = Pool(network)
    result: dict[str, IPv4Address] = {}
    wanted = sorted(names)
    for name in wanted:
        had = address_of(previous.get(name))
        if had is not None and had in pool and had not in result.values():
            result[name] = had
    for name in wanted:
        if name not in result:
            result[name] = find_free(pool, name, salt, set(result.values()))
    return {name: f"{result[name]}/{pool.subnet.prefixlen}" for name in wanted}


def find_free(pool: Pool, name: str, salt: str, taken: set[IPv4Address]) -> IPv4Address:
    """Return the first free address, beginning where the hash of the name points to."""
    number = int.from_bytes(hashlib.sha256(f"{salt}/{name}".encode()).digest()[:8], "big")
    for address in pool.iterate_from(number):
        if address not in taken:
            return address
    raise ValueError(f"{len(taken)} addresses are given out, and none is left for {name}")


def address_of(text: str | None) -> IPv4Address | None:
    """Return an address that was written with or without its prefix length."""
    try:
        return IPv4Address((text or "").partition("/")[0])
    except ValueError:
        return None


def read_addresses(objects: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the addresses that a revision's workloads have, by workload."""
    found = ((item["metadata"]["name"], read_note(item)) for item in objects)
    return {name: str(note["address"]) for name, note in found if note.get("address")}


def read_note(item: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the network annotation of a workload's pods, empty if it is missing or invalid."""
    template = (item.get("spec") or {}).get("template") or {}
    annotations = (template.get("metadata") or {}).get("annotations") or {}
    try:
        note = json.loads(annotations.get(NETWORK_ANNOTATION, "{}"))
    except ValueError:
        return {}
    return note if isinstance(note, dict) else {}

"""Addresses of `ipam: static`: one for each workload, the same for as long as it lives.

A workload that has an address keeps it. The address of a new workload is derived from its name, so
no cluster is needed and two renders agree. Of an object, this module only reads the annotation that
contains the address.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from ipaddress import IPv4Address, IPv4Network, collapse_addresses
from typing import Any

from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NETWORK_ANNOTATION
from rigel_k8s.objects.overlay import parse_json


class Pool:
    """The addresses that may be given out, as (first, last) of each stretch without gaps.

    Raises:
        ValueError: the options have no range of addresses; the checks report where and why.
    """

    def __init__(self, network: Network) -> None:
        self.subnet = IPv4Network(network.subnet or "", strict=False)
        ends = self.subnet.network_address, self.subnet.broadcast_address
        self.first = int(IPv4Address(network.range_start or ends[0]))
        last = int(IPv4Address(network.range_end or ends[1]))
        self.span = max(1, last - self.first + 1)
        never = [*network.exclude, *filter(None, [network.gateway]), *map(str, ends)]
        self.stretches: list[tuple[int, int]] = []
        start = self.first
        for taken in collapse_addresses(IPv4Network(item, strict=False) for item in never):
            self._add(start, min(last, int(taken.network_address) - 1))
            start = max(start, int(taken.broadcast_address) + 1)
        self._add(start, last)

    def _add(self, first: int, last: int) -> None:
        if first <= last:
            self.stretches.append((first, last))

    def __contains__(self, address: IPv4Address) -> bool:
        """Return whether an address may be given out."""
        return any(first <= int(address) <= last for first, last in self.stretches)

    def __len__(self) -> int:
        return sum(last - first + 1 for first, last in self.stretches)

    def iterate_from(self, number: int) -> Iterator[IPv4Address]:
        """Yield all addresses, once each, beginning at any of them."""
        start = self.first + number % self.span
        for first, last in self.stretches:
            yield from map(IPv4Address, range(max(first, start), last + 1))
        for first, last in self.stretches:
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
    return parse_json(annotations.get(NETWORK_ANNOTATION), {})

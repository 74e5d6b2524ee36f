"""Address ranges that this machine does not use; it only reads routes, addresses, name servers."""

from __future__ import annotations

import ipaddress
import json
from collections.abc import Iterable
from contextlib import suppress
from itertools import chain
from pathlib import Path

import attrs

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster.commands import run

Network = ipaddress.IPv4Network

#: Where a block may be, in the order of trial: all private, the rarely used first.
CANDIDATES = ("10.64.0.0/10", "10.128.0.0/9", "10.0.0.0/10", "172.16.0.0/12", "100.64.0.0/10")


@attrs.frozen
class Addresses:
    """The ranges of one cluster: one /14 block cut into pods, services and machines."""

    block: str

    def _part(self, index: int) -> Network:
        return list(Network(self.block).subnets(new_prefix=16))[index]

    @property
    def pods(self) -> str:
        """All pods: a /16, one /24 of it for each node."""
        return str(self._part(0))

    @property
    def services(self) -> str:
        """All Services' cluster addresses: a /16."""
        return str(self._part(1))

    @property
    def machines(self) -> Network:
        """The Ethernet segment of host, control plane and nodes: a /24."""
        return Network(f"{self._part(2).network_address}/24")

    def machine(self, number: int) -> str:
        """Return an address on the segment: 1 the host, 2 the control plane, 11 the first node."""
        return str(self.machines.network_address + number)

    def pod_range(self, node: str) -> str:
        index = int(node.removeprefix("node"))
        return str(list(Network(self.pods).subnets(new_prefix=24))[index])

    @property
    def api_service(self) -> str:
        """The cluster address of the Service `kubernetes`."""
        return str(Network(self.services).network_address + 1)

    @property
    def dns_service(self) -> str:
        """The cluster address of DNS."""
        return str(Network(self.services).network_address + 10)


def choose(taken: Iterable[str] = ()) -> Addresses:
    """Return ranges that no route, address or name server of this machine is in.

    Args:
        taken: blocks of other clusters, whose pods and services have no route.

    Raises:
        LocalClusterError: every private range is in use.
    """
    return find_free_block([*find_used_networks(), *map(Network, taken)])


def find_free_block(used: Iterable[Network]) -> Addresses:
    """Return the first /14 of the candidates that overlaps with none."""
    avoid = list(used)
    ranges = map(Network, CANDIDATES)
    for block in chain.from_iterable(each.subnets(new_prefix=14) for each in ranges):
        if not any(block.overlaps(network) for network in avoid):
            return Addresses(str(block))
    raise LocalClusterError(
        "no free address range: the routes of this machine cover every private network",
        hint="end a VPN or another cluster first; `ip route show table all` lists the routes",
    )


def find_used_networks() -> list[Network]:
    """Return every IPv4 network that this machine has a route, an address or a name server in."""
    routes = json.loads(run(["ip", "-j", "-4", "route", "show", "table", "all"]) or "[]")
    links = json.loads(run(["ip", "-j", "-4", "addr"]) or "[]")
    infos = [info for link in links for info in link.get("addr_info", [])]
    found = [route["dst"] for route in routes if "dst" in route]
    found += [f"{info['local']}/{info['prefixlen']}" for info in infos]
    found += [info["address"] for info in infos if "address" in info]
    return [n for n in networks([*found, *name_servers()]) if n.prefixlen > 0]


def networks(texts: Iterable[str]) -> Iterable[Network]:
    """Yield what is an IPv4 network or address; `default` and IPv6 are not."""
    for text in texts:
        with suppress(ValueError):
            yield Network(text, strict=False)


def name_servers() -> list[str]:
    """Return the machine's name servers, those behind systemd-resolved too."""
    files = [Path("/etc/resolv.conf"), Path("/run/systemd/resolve/resolv.conf")]
    lines = [line.split() for f in files if f.exists() for line in f.read_text().splitlines()]
    return [words[1] for words in lines if words[:1] == ["nameserver"] and len(words) > 1]

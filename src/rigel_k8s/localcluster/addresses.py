"""Address ranges that this machine does not use; it only reads routes and addresses."""

from __future__ import annotations

import ipaddress
import json
from collections.abc import Iterable

import attrs

from rigel_k8s.errors import LocalClusterError
from rigel_k8s.localcluster.components import run

__all__ = ["Addresses", "choose"]

Network = ipaddress.IPv4Network


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

    def machine(self, index: int) -> str:
        """Return an address on the segment: 1 the host, 2 the control plane, 11 the first node."""
        return str(self.machines.network_address + index)

    def pod_range(self, index: int) -> str:
        """Return the pods of one node, counted from 1."""
        return str(list(Network(self.pods).subnets(new_prefix=24))[index])

    @property
    def api_service(self) -> str:
        """The cluster address of the Service `kubernetes`."""
        return str(Network(self.services).network_address + 1)

    @property
    def dns_service(self) -> str:
        """The cluster address of DNS."""
        return str(Network(self.services).network_address + 10)


def choose() -> Addresses:
    """Return ranges that no route, address or name server of this machine is in.

    Raises:
        LocalClusterError: all of 10.0.0.0/8 is in use.
    """
    return free_block(used_networks())


def free_block(used: Iterable[Network]) -> Addresses:
    """Return the first /14 of 10.64.0.0/10, then of the rest of 10.0.0.0/8, that overlaps none."""
    taken = list(used)
    blocks = list(Network("10.0.0.0/8").subnets(new_prefix=14))
    for block in [*blocks[16:], *blocks[:16]]:
        if not any(block.overlaps(network) for network in taken):
            return Addresses(str(block))
    raise LocalClusterError(
        "no free address range: routes of this machine cover all of 10.0.0.0/8",
        hint="end a VPN or another cluster first",
    )


def used_networks() -> list[Network]:
    """Return every IPv4 network that this machine has a route, an address or a name server in."""
    found = []
    for route in json.loads(run(["ip", "-j", "-4", "route", "show", "table", "all"]) or "[]"):
        if (target := route.get("dst")) and target != "default":
            found.append(Network(target, strict=False))
    for link in json.loads(run(["ip", "-j", "-4", "addr"]) or "[]"):
        for info in link.get("addr_info", []):
            found.append(Network(f"{info['local']}/{info['prefixlen']}", strict=False))
    return [network for network in found if network.prefixlen > 0]

"""A cluster's Ethernet segment: a bridge, and a network namespace for each of its machines.

If this machine drops what it forwards, rules let the bridge's traffic through: Docker sets that
policy, and if br_netfilter is loaded, it affects frames between two nodes as well.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from rigel_k8s.errors import CommandFailed
from rigel_lab.cluster.addresses import Addresses
from rigel_lab.cluster.commands import run, succeeds
from rigel_lab.cluster.layout import Layout, number

LEGACY_TABLES = Path("/proc/net/ip_tables_names")


def prefix(cluster: str) -> str:
    """Return the prefix of a cluster's interfaces; their names have 15 characters at most."""
    return f"rk{hashlib.sha256(cluster.encode()).hexdigest()[:6]}"


def bridge_name(cluster: str) -> str:
    return f"{prefix(cluster)}br"


def link_name(cluster: str, machine: str) -> str:
    """Return the name of the bridge's end of a machine's cable."""
    return f"{prefix(cluster)}m{number(machine)}"


def table_name(cluster: str) -> str:
    """Return the name of a cluster's nft table."""
    return f"rigel_{cluster.replace('-', '_')}"


def mtu() -> int:
    """Return the size of the largest packet that leaves this machine whole, at most Ethernet's."""
    routes = json.loads(run(["ip", "-j", "-4", "route", "show", "default"]) or "[]")
    ways_out = {route["dev"] for route in routes if "dev" in route}
    links = json.loads(run(["ip", "-j", "link", "show"]))
    return min([1500, *(int(link["mtu"]) for link in links if link["ifname"] in ways_out)])


def exists(link: str) -> bool:
    """Return whether an interface exists; /sys may show another namespace's."""
    return succeeds(["ip", "link", "show", "dev", link])


def create(cluster: str, addresses: Addresses) -> None:
    """Make the segment of a cluster, and its way out."""
    bridge = bridge_name(cluster)
    if not exists(bridge):
        run(["ip", "link", "add", bridge, "type", "bridge"])
    run(["ip", "link", "set", bridge, "mtu", str(mtu()), "up"])
    address = f"{addresses.machine(1)}/{addresses.machines.prefixlen}"
    run(["ip", "addr", "replace", address, "dev", bridge])
    masquerade(cluster, addresses.block)
    allow_forwarding(bridge)


def masquerade(cluster: str, block: str) -> None:
    """Hide the cluster behind the machine for what leaves both.

    If br_netfilter is active, the rule affects frames between two nodes as well: their multicast
    would come from the machine, and no node would recognize the sender.
    """
    table = f"table ip {table_name(cluster)}"
    run(
        ["nft", f"{table} {{}}; delete {table}; {table} {{ chain out {{"]
        + ["type nat hook postrouting priority srcnat;"]
        + [f"ip saddr {block} ip daddr != {block} oifname != {bridge_name(cluster)} masquerade;"]
        + ["}; };"]
    )


def allow_forwarding(bridge: str) -> None:
    """Accept what a bridge forwards, before everything else, if it would be dropped.

    If nothing is dropped, neither a rule nor a table is made.
    """
    for tool in filter(drops, list_iptables()):
        for rule in forwarding_rules(bridge):
            if not succeeds([tool, "-w", "-C", *rule]):
                run([tool, "-w", "-I", *rule])


def list_iptables() -> list[str]:
    """Return the kinds of iptables that have a FORWARD chain on this machine now."""
    nft = succeeds(["nft", "list", "chain", "ip", "filter", "FORWARD"])
    legacy = LEGACY_TABLES.exists() and "filter" in LEGACY_TABLES.read_text().split()
    return ["iptables-nft"] * nft + ["iptables-legacy"] * legacy


def drops(tool: str) -> bool:
    """Return whether the FORWARD chain drops by policy."""
    if tool == "iptables-nft":  # without the translation layer, which would make missing chains
        with suppress(CommandFailed):
            listing = json.loads(run(["nft", "-j", "list", "chain", "ip", "filter", "FORWARD"]))
            chains = [item["chain"] for item in listing["nftables"] if "chain" in item]
            return any(chain.get("policy") == "drop" for chain in chains)
        return False
    return run([tool, "-w", "-S", "FORWARD"]).startswith("-P FORWARD DROP")


def forwarding_rules(bridge: str) -> list[list[str]]:
    """Return the rules of a bridge, as iptables takes them."""
    return [["FORWARD", side, bridge, "-j", "ACCEPT"] for side in ("-i", "-o")]


def forget_forwarding(bridge: str) -> None:
    """Remove a bridge's rules."""
    for tool in list_iptables():
        for rule in forwarding_rules(bridge):
            while succeeds([tool, "-w", "-D", *rule]):
                pass


def wire(layout: Layout, machine: str) -> None:
    """Recreate a machine's network namespace and connect its eth0 to the segment."""
    unwire(layout, machine)
    namespace, link = layout.namespace(machine), link_name(layout.name, machine)
    run(["ip", "netns", "add", namespace])
    size = ["mtu", str(mtu())]
    run(
        ["ip", "link", "add", link, *size, "type", "veth"]
        + ["peer", "name", "eth0", "address", hardware_address(layout.address(machine))]
        + [*size, "netns", namespace]
    )
    run(["ip", "link", "set", link, "master", bridge_name(layout.name), "up"])
    inside = ["ip", "-n", namespace]
    address = f"{layout.address(machine)}/{layout.addresses.machines.prefixlen}"
    run([*inside, "link", "set", "lo", "up"])
    run([*inside, "addr", "add", address, "dev", "eth0"])
    run([*inside, "link", "set", "eth0", "up"])
    run([*inside, "route", "add", "default", "via", layout.addresses.machine(1)])


def hardware_address(address: str) -> str:
    """Return the MAC address that belongs to an IP address.

    A machine that is started again keeps it; with a new one the others would continue to send to
    the old one, until their neighbour tables forget it.
    """
    return "02:52:" + ":".join(f"{int(part):02x}" for part in address.split("."))


def route(layout: Layout, machine: str, nodes: Iterable[str]) -> None:
    """Give a machine a route to every other node's pods."""
    for node in nodes:
        if node != machine:
            run(
                ["ip", "-n", layout.namespace(machine), "route", "replace"]
                + [layout.addresses.pod_range(node), "via", layout.address(node)]
            )


def unwire(layout: Layout, machine: str) -> None:
    """Remove a machine's cable and namespace, whose processes have ended."""
    link = link_name(layout.name, machine)
    if exists(link):
        run(["ip", "link", "del", link])
    if Path("/run/netns", layout.namespace(machine)).exists():
        run(["ip", "netns", "del", layout.namespace(machine)])


def remove(layout: Layout, machines: Iterable[str]) -> None:
    """Remove a cluster's namespaces, bridge, table and rules, as far as they exist."""
    for machine in machines:
        unwire(layout, machine)
    bridge = bridge_name(layout.name)
    if exists(bridge):
        run(["ip", "link", "del", bridge])
    with suppress(CommandFailed):
        run(["nft", "delete", "table", "ip", table_name(layout.name)])
    forget_forwarding(bridge)

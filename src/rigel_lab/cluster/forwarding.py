"""Rules that let a bridge's traffic through if this machine drops what it forwards.

Docker sets that policy, and if br_netfilter is loaded, it affects frames between two nodes as well.
If nothing is dropped, neither a rule nor a table is made.
"""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path

from rigel_k8s.errors import CommandFailed
from rigel_lab.cluster.commands import run, succeeds

LEGACY_TABLES = Path("/proc/net/ip_tables_names")


def tools() -> list[str]:
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


def rules(bridge: str) -> list[list[str]]:
    """Return the rules of a bridge, as iptables takes them."""
    return [["FORWARD", side, bridge, "-j", "ACCEPT"] for side in ("-i", "-o")]


def allow(bridge: str) -> None:
    """Accept what a bridge forwards, before everything else, if it would be dropped."""
    for tool in filter(drops, tools()):
        for rule in rules(bridge):
            if not succeeds([tool, "-w", "-C", *rule]):
                run([tool, "-w", "-I", *rule])


def forget(bridge: str) -> None:
    """Remove a bridge's rules."""
    for tool in tools():
        for rule in rules(bridge):
            while succeeds([tool, "-w", "-D", *rule]):
                pass

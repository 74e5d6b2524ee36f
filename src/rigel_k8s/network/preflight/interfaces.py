"""Checks whether each machine has the interface of an attachment, and whether it can carry it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rigel_k8s.network.preflight.attachments import Attachment
from rigel_k8s.network.preflight.case import Case
from rigel_k8s.network.preflight.finding import PreflightKind, group_by_text, list_some
from rigel_k8s.network.preflight.machine import Interface, MachineFacts
from rigel_k8s.problems import Problem

INTERFACE_UNSAID = PreflightKind(
    "interface-unsaid",
    "no interface is set, and the machine has no default route",
    "Rigelfile",
    "`/proc/net/route`",
)
INTERFACE_MISSING = PreflightKind(
    "interface-missing",
    "a machine does not have this interface; the message lists those that it has",
    "Rigelfile",
    "`/sys/class/net`",
)
INTERFACE_WIRELESS = PreflightKind(
    "interface-wireless",
    "macvlan over Wi-Fi: access points drop further MAC addresses",
    "Rigelfile",
    "`wireless` or `phy80211` in `/sys/class/net/NAME`, or `DEVTYPE=wlan`",
)
INTERFACE_NOT_ETHERNET = PreflightKind(
    "interface-not-ethernet",
    "macvlan over a tunnel, a loopback interface or the like",
    "Rigelfile",
    "`/sys/class/net/NAME/type`",
)
INTERFACE_DOWN = PreflightKind(
    "interface-down",
    "the interface is switched off",
    "cluster",
    "`/sys/class/net/NAME/flags`",
)
INTERFACE_NO_CARRIER = PreflightKind(
    "interface-no-carrier",
    "no cable is plugged in",
    "warning",
    "`/sys/class/net/NAME/operstate`",
)
MTU = PreflightKind(
    "mtu",
    "`network.mtu` is larger than that of the interface",
    "Rigelfile",
    "`/sys/class/net/NAME/mtu`",
)
INTERFACE_PORT = PreflightKind(
    "interface-port",
    "the interface is a port of a bridge or a bond, which takes all that arrives",
    "Rigelfile",
    "interfaces on top of it",
)

#: Interfaces that networks of pods and container engines have made: not meant for attachments.
OTHERS = ("lo", "veth", "cali", "lxc", "cni", "flannel", "docker", "kube-", "br-", "cilium", "tunl")
#: Interfaces that take everything that arrives at their ports, so a port carries nothing else.
TAKES_ALL = ("bridge", "bond", "team", "openvswitch")


def interfaces(case: Case) -> Iterator[Problem]:
    """Yield what is wrong with the interfaces that attachments, or pods themselves, use."""
    if case.network.mode == "host" and case.network.interface:
        seen = {n: f for n, f in case.view.machines.items() if n in case.nodes()}
        name = case.network.interface
        yield from _check_presence({node: (name, facts) for node, facts in seen.items()})
    for one in case.attachments:
        if one.on_an_interface:
            found = {node: (_master(one, facts), facts) for node, facts in case.machines(one)}
            yield from _check_presence(found)
            there = {n: f.interfaces[m] for n, (m, f) in found.items() if m in f.interfaces}
            yield from _check_fitness(one, there)
            yield from _check_port(one, found)


def _master(one: Attachment, facts: MachineFacts) -> str:
    return one.master or facts.default_interface or ""


Found = Mapping[str, tuple[str, MachineFacts]]


def _check_presence(found: Found) -> Iterator[Problem]:
    nameless = [node for node, (master, _) in found.items() if not master]
    if nameless:
        yield INTERFACE_UNSAID.problem(
            f"no interface is named, and {list_some(nameless)} has no default route to take it"
            " from",
            "set `network.interface`",
        )
    missing = {
        node: f"{master} (there: {_list_usable(facts) or 'none'})"
        for node, (master, facts) in found.items()
        if master and master not in facts.interfaces
    }
    for text, nodes in group_by_text(missing).items():
        verb = "has" if len(nodes) == 1 else "have"
        yield INTERFACE_MISSING.problem(
            f"{list_some(nodes)} {verb} no interface {text}",
            "set `network.interface` to one that exists on every machine that pods may run on, or"
            " keep the pods away from the others with `placement`",
        )


def _list_usable(facts: MachineFacts) -> str:
    names = sorted(name for name in facts.interfaces if not name.startswith(OTHERS))
    return list_some(
        (f"{n} (wireless)" if facts.interfaces[n].wireless else n for n in names), most=8
    )


def _check_fitness(one: Attachment, there: Mapping[str, Interface]) -> Iterator[Problem]:
    for rule in (_check_wireless, _check_ethernet, _check_up, _check_carrier, _check_mtu):
        findings: dict[Problem, None] = {}
        for i in dict.fromkeys(there.values()):
            nodes = list_some(node for node, other in there.items() if other == i)
            findings |= dict.fromkeys(rule(one, i, f"{i.name} of {nodes}"))
        yield from findings


def _check_wireless(one: Attachment, i: Interface, which: str) -> Iterator[Problem]:
    if i.wireless and one.program == "macvlan":
        yield INTERFACE_WIRELESS.problem(
            f"{which} is wireless: access points drop packets from macvlan's additional MAC"
            " addresses",
            "use `mode: peers` or `discovery-server`, which need no second network",
        )


def _check_ethernet(one: Attachment, i: Interface, which: str) -> Iterator[Problem]:
    if not i.ethernet and one.program == "macvlan":
        yield INTERFACE_NOT_ETHERNET.problem(
            f"{which} is not an Ethernet interface, so it cannot carry macvlan",
            "use another `network.interface`, or `mode: peers` or `discovery-server`",
        )


def _check_up(one: Attachment, i: Interface, which: str) -> Iterator[Problem]:
    if not i.up:
        yield INTERFACE_DOWN.problem(
            f"{which} is down: pods would start and receive nothing",
            f"run `ip link set {i.name} up` there, and change the machine's network configuration",
        )


def _check_carrier(one: Attachment, i: Interface, which: str) -> Iterator[Problem]:
    if i.up and i.state in ("down", "lowerlayerdown", "dormant"):
        yield INTERFACE_NO_CARRIER.problem(
            f"{which} has no link ({i.state}): is its cable plugged in?",
            "until it has one, pods start but receive nothing",
        )


def _check_mtu(one: Attachment, i: Interface, which: str) -> Iterator[Problem]:
    if one.mtu > i.mtu:
        yield MTU.problem(
            f"the MTU {one.mtu} is larger than that of {which}, {i.mtu}",
            f"set `network.mtu` to at most {i.mtu}, or remove it",
        )


def _check_port(one: Attachment, found: Found) -> Iterator[Problem]:
    """Yield ports of a bridge or a bond: the kernel only reports "Device or resource busy"."""
    for node, (master, facts) in found.items():
        uppers = facts.interfaces[master].uppers if master in facts.interfaces else ()
        for upper in (facts.interfaces[name] for name in uppers if name in facts.interfaces):
            if upper.kind in TAKES_ALL:
                yield INTERFACE_PORT.problem(
                    f"{master} of {node} is a port of {upper.kind} {upper.name}, so it cannot carry"
                    f" {one.program}",
                    f"set `interface: {upper.name}`",
                )

"""The interface below a second network: each finding with its words."""

from __future__ import annotations

import attrs

from rigel_k8s.network.options import Network
from rigel_k8s.network.preflight.case import MachineView
from rigel_k8s.network.preflight.machine import MachineFacts

from .cases import found, machine, nad, texts, view, with_interface, workload

WHERE = (
    "set `network.interface` to one that exists on every machine that pods may run on, or keep"
    " the pods away from the others with `placement`"
)


def second(facts: MachineFacts) -> MachineView:
    """Two machines, of which the second one is special."""
    return view(machines={"node1": machine(), "node2": facts})


def test_missing_on_one_machine() -> None:
    """The machine is named, and what it has; interfaces of pods are no choice."""
    seen = view(machines={"node1": with_interface("eth1"), "node2": machine()})
    assert texts(found(nad(master="eth1"), workload(), seen=seen)) == [
        "error rigelfile interface-missing: node2 has no interface eth1 (there: eth0) => " + WHERE
    ]


def test_missing_on_several() -> None:
    """Machines that have the same are told together, and what is wireless is marked."""
    facts = with_interface("wlan0", wireless=True)
    seen = view(machines={"node1": facts, "node2": facts})
    assert texts(found(nad(master="enp3s0"), workload(), seen=seen)) == [
        "error rigelfile interface-missing: node1, node2 have no interface enp3s0"
        " (there: eth0, wlan0 (wireless)) => " + WHERE
    ]


def test_missing_for_the_machines_own_network() -> None:
    """Mode host is pinned to an interface that must be there, too."""
    host = workload(networks=None, hostNetwork=True)
    assert texts(found(host, network=Network(mode="host", interface="eth7"))) == [
        "error rigelfile interface-missing: node1, node2 have no interface eth7 (there: eth0) => "
        + WHERE
    ]


def test_the_default_routes_interface_is_meant_where_none_is_named() -> None:
    """macvlan takes the interface of the default route; without such a route one must be named."""
    item = nad(master=None)
    assert found(item, workload()) == []
    routeless = machine(routes=tuple(r for r in machine().routes if r.subnet.prefixlen))
    assert texts(found(item, workload(), seen=second(routeless))) == [
        "error rigelfile interface-unsaid: no interface is named, and node2 has no default"
        " route to take it from => set `network.interface`"
    ]


def test_wireless() -> None:
    """macvlan over Wi-Fi is refused with what works instead."""
    wireless = with_interface("wlan0", wireless=True)
    seen = view(machines={"node1": wireless, "node2": wireless})
    assert texts(found(nad(master="wlan0"), workload(), seen=seen)) == [
        "error rigelfile interface-wireless: wlan0 of node1, node2 is wireless: access points"
        " drop packets from macvlan's additional MAC addresses => use `mode: peers` or"
        " `discovery-server`, which need no second network"
    ]


def test_no_ethernet() -> None:
    """A tunnel carries no macvlan."""
    facts = with_interface("wg0", ethernet=False)
    seen = view(machines={"node1": facts, "node2": facts})
    assert texts(found(nad(master="wg0"), workload(), seen=seen)) == [
        "error rigelfile interface-not-ethernet: wg0 of node1, node2 is not an Ethernet"
        " interface, so it cannot carry macvlan => use another `network.interface`, or `mode:"
        " peers` or `discovery-server`"
    ]


def test_down() -> None:
    """An interface that is switched off on one machine."""
    facts = with_interface("eth0", up=False, state="down")
    assert texts(found(seen=second(facts))) == [
        "error cluster interface-down: eth0 of node2 is down: pods would start and receive"
        " nothing => run `ip link set eth0 up` there, and change the machine's network"
        " configuration"
    ]


def test_no_cable() -> None:
    """A cable that is not plugged in may be plugged in later: a warning."""
    facts = with_interface("eth0", state="lowerlayerdown")
    assert texts(found(seen=second(facts))) == [
        "warning cluster interface-no-carrier: eth0 of node2 has no link (lowerlayerdown): is"
        " its cable plugged in? => until it has one, pods start but receive nothing"
    ]


def test_mtu() -> None:
    """An MTU beyond the machine's is refused by the program; here it is told before."""
    assert texts(found(nad(mtu=1500), workload())) == [
        "error rigelfile mtu: the MTU 1500 is larger than that of eth0 of node1, node2, 1400"
        " => set `network.mtu` to at most 1400, or remove it"
    ]


def test_a_port_of_a_bridge() -> None:
    """A bridge, or a bond, has its ports for itself; the kernel only says that they are busy."""
    facts = with_interface("eth0", uppers=("br0", "lan.7"))
    bridge = attrs.evolve(facts.interfaces["eth0"], name="br0", kind="bridge", uppers=())
    vlan = attrs.evolve(bridge, name="lan.7", kind="vlan")
    more = {**facts.interfaces, "br0": bridge, "lan.7": vlan}
    assert texts(found(seen=second(attrs.evolve(facts, interfaces=more)))) == [
        "error rigelfile interface-port: eth0 of node2 is a port of bridge br0, so it cannot"
        " carry macvlan => set `interface: br0`"
    ]

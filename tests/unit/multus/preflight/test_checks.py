"""Multus, programs, interfaces, addresses: each finding with its words."""

from __future__ import annotations

from ipaddress import ip_network
from typing import Any

import attrs
import pytest

from rigel_k8s.network.options import Network
from rigel_multus.preflight.attachments import read_attachment
from rigel_multus.preflight.case import ClusterView
from rigel_multus.preflight.machine import MachineFacts

from .cases import addresses, found, machine, nad, node, texts, view, with_interface, workload

INSTALL = "run `rigel network install`, or set `network: {install: true}` in the Rigelfile"


def test_all_is_well() -> None:
    """Nothing is found where nothing is wrong."""
    assert texts(found()) == []


def test_no_multus() -> None:
    """A cluster without Multus is one finding, whatever else cannot be there either."""
    assert texts(found(seen=view(multus=False, daemons={}, machines={}))) == [
        "error cluster multus-missing: Multus is not installed: the cluster has no kind"
        f" NetworkAttachmentDefinition => {INSTALL}"
    ]


def test_no_daemon_on_a_machine() -> None:
    """A machine that pods may run on and Multus does not is named."""
    daemons = {k: v for k, v in (view().daemons or {}).items() if k == "node1"}
    assert texts(found(seen=view(daemons=daemons))) == [
        "error cluster multus-not-on-node: no Multus daemon runs on node2, where pods of the"
        f" release may run => {INSTALL}; or keep the pods away from these machines with"
        " `placement`"
    ]


def test_no_whereabouts() -> None:
    """A cluster without whereabouts gives no addresses by it; others need none."""
    seen = view(whereabouts=False)
    assert texts(found(seen=seen)) == [
        "error cluster whereabouts-missing: whereabouts is not installed: the cluster has no"
        f" kind IPPool => {INSTALL}; or use another `network.ipam`"
    ]
    assert found(nad(ipam={"type": "static"}), workload(), seen=seen) == []


def test_only_machines_that_pods_may_run_on_count() -> None:
    """A machine that the pods' selector or a taint keeps away may lack everything."""
    tainted = node("node2")
    tainted["spec"]["taints"] = [{"key": "gpu", "effect": "NoSchedule"}]
    bare = view(daemons={"node1": (view().daemons or {})["node1"]})
    pinned = workload(nodeSelector={"kubernetes.io/hostname": "node1"})
    assert found(nad(), pinned, seen=bare) == []
    keeps = attrs.evolve(bare, nodes=[node("node1"), tainted])
    assert found(seen=keeps) == []
    tolerant = workload(tolerations=[{"key": "gpu", "operator": "Exists"}])
    assert [f.kind for f in found(nad(), tolerant, seen=keeps)] == ["multus-not-on-node"]


def test_a_machine_that_is_off_lacks_nothing() -> None:
    """A robot that is off keeps nobody from deploying."""
    seen = view(
        nodes=[node("node1"), node("node2", ready=False)],
        daemons={"node1": (view().daemons or {})["node1"]},
    )
    assert found(seen=seen) == []


def test_a_daemon_that_is_not_ready() -> None:
    """Pods that start while the daemon is away come up without their network: it is told why."""
    daemons = dict(view().daemons or {})
    daemons["node2"] = attrs.evolve(daemons["node2"], state="CrashLoopBackOff")
    assert texts(found(seen=view(daemons=daemons))) == [
        "error cluster multus-not-ready: the Multus daemon on node2 is not ready: CrashLoopBackOff"
        " => kubectl -n kube-system logs multus-node2 -c kube-multus"
    ]


def test_an_attachment_that_is_not_there() -> None:
    """A missing attachment is named with its namespace, beside those that are there."""
    there = read_attachment(nad("lab", "nets"))
    found_here = found(workload(), seen=view(attachments={there.key: there}))
    assert texts(found_here) == [
        "error rigelfile attachment-missing: the NetworkAttachmentDefinition robot/lan does"
        " not exist (the cluster has: nets/lab) => set `network.attachment` to an existing"
        " one, as NAMESPACE/NAME, or create it"
    ]


def test_an_attachment_that_could_not_be_read_may_be_there() -> None:
    """What may not be read is not called missing."""
    assert found(workload(), seen=view(unread=frozenset({"robot/lan"}))) == []


@pytest.mark.parametrize(
    ("lacking", "remedy"),
    [
        (
            ["macvlan", "whereabouts"],
            "on k3s and kind, set `network: {install: true}`; elsewhere, set"
            " `network.install.plugins_image` to an image that has them, or unpack the CNI"
            " plugins' release in that directory",
        ),
        (["whereabouts"], INSTALL),
    ],
)
def test_a_program_that_a_machine_lacks(lacking: list[str], remedy: str) -> None:
    """The program, the machine and the directory that was looked into are named."""
    recorded = machine().programs["/opt/cni/bin"]
    poor = machine(programs={"/opt/cni/bin": recorded - set(lacking)})
    assert texts(found(seen=view(machines={"node1": machine(), "node2": poor}))) == [
        f"error cluster program-missing: CNI programs are missing on node2: {', '.join(lacking)}"
        f" (looked into /opt/cni/bin) => {remedy}"
    ]


def test_all_programs_of_a_chain_count() -> None:
    """In a list of plugins each of them must be there, and the first one's of addresses."""
    item = nad()
    item["spec"]["config"] = (
        '{"cniVersion": "0.3.1", "plugins": [{"type": "macvlan", "master": "eth0",'
        ' "ipam": {"type": "static"}}, {"type": "tc"}]}'
    )
    assert texts(found(item, workload())) == [
        "error cluster program-missing: CNI programs are missing on node1, node2: tc (looked into"
        " /opt/cni/bin) => put them into that directory on each of these machines"
    ]


def test_the_machines_own_network_needs_no_multus() -> None:
    """Nothing of all this is asked of a release on the machines' own network."""
    seen = view(multus=False, daemons={}, machines={})
    host = workload(networks=None, hostNetwork=True)
    assert found(host, seen=seen, network=Network(mode="host")) == []


WHERE = (
    "set `network.interface` to one that exists on every machine that pods may run on, or keep"
    " the pods away from the others with `placement`"
)


def second(facts: MachineFacts) -> ClusterView:
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
    """macvlan takes the interface of the default route, which is looked at."""
    item = nad(master=None)
    assert found(item, workload()) == []
    seen = second(with_interface("eth0", up=False))
    assert [f.kind for f in found(item, workload(), seen=seen)] == ["interface-down"]


def test_wireless() -> None:
    """macvlan over Wi-Fi is refused with what works instead."""
    wireless = with_interface("wlan0", wireless=True)
    seen = view(machines={"node1": wireless, "node2": wireless})
    assert texts(found(nad(master="wlan0"), workload(), seen=seen)) == [
        "error rigelfile interface-wireless: wlan0 of node1, node2 is wireless: access points"
        " drop packets from macvlan's additional MAC addresses => use `mode: peers` or"
        " `discovery-server`, which need no second network"
    ]


def test_down() -> None:
    """An interface that is switched off on one machine."""
    facts = with_interface("eth0", up=False)
    assert texts(found(seen=second(facts))) == [
        "error cluster interface-down: eth0 of node2 is down: pods would start and receive"
        " nothing => run `ip link set eth0 up` there, and change the machine's network"
        " configuration"
    ]


def test_mtu() -> None:
    """An MTU beyond the machine's is refused by the program; here it is told before."""
    assert texts(found(nad(mtu=1500), workload())) == [
        "error rigelfile mtu: the MTU 1500 is larger than that of eth0 of node1, node2, 1400"
        " => set `network.mtu` to at most 1400, or remove it"
    ]


KEEP_OFF = "exclude them with `network.range_start`, `range_end` or `exclude`"


IPS = {"capabilities": {"ips": True}}


def whereabouts(text: str, **more: Any) -> dict[str, Any]:
    return nad(ipam={"type": "whereabouts", "range": text, **more})


def static(*ips: str) -> str:
    listed = ", ".join(f'"{ip}"' for ip in ips)
    return f'[{{"name": "lan", "interface": "net1", "ips": [{listed}]}}]'


def test_pod_network() -> None:
    """A subnet within the pods' is told with the machines whose pods it hits."""
    assert texts(found(whereabouts("10.64.0.0/16"), workload())) == [
        "error rigelfile pod-network: subnet 10.64.0.0/16 overlaps the pod network:"
        " 10.64.1.0/24 (node1), 10.64.2.0/24 (node2): pods would look for those on the second"
        " network => set `network.subnet` to a range that nothing in the cluster uses"
    ]


def test_service_network() -> None:
    """A subnet within the Services' would take DNS from the pods."""
    seen = view(services=[ip_network("10.77.0.0/16"), ip_network("fd00::/108")])
    assert texts(found(seen=seen)) == [
        "error rigelfile service-network: subnet 10.77.0.0/24 overlaps the Services' network:"
        " 10.77.0.0/16: pods would look for those on the second network => set"
        " `network.subnet` to a range that nothing in the cluster uses"
    ]


def test_addresses_of_machines() -> None:
    """On the machines' own subnet, whereabouts would give out their addresses."""
    assert texts(found(whereabouts("10.66.0.0/24"), workload())) == [
        "error rigelfile machine-address: pods would get addresses that machines have:"
        " 10.66.0.11 (node1), 10.66.0.12 (node2) => " + KEEP_OFF
    ]


def test_addresses_of_machines_on_other_interfaces() -> None:
    """Addresses that Kubernetes does not know a machine by count as well."""
    seen = view(machines={"node1": machine(addresses=addresses("10.77.0.1")), "node2": machine()})
    assert [f.message for f in found(seen=seen)] == [
        "pods would get addresses that machines have: 10.77.0.1 (node1)"
    ]


@pytest.mark.parametrize(
    "more",
    [
        {"range_start": "10.66.0.100"},
        {"range_end": "10.66.0.9"},
        {"exclude": ["10.66.0.8/29", "10.66.0.12/32"]},
    ],
)
def test_addresses_kept_off_the_machines(more: dict[str, Any]) -> None:
    """A start, an end or excluded addresses make the machines' own subnet fit."""
    assert found(whereabouts("10.66.0.0/24", **more), workload()) == []


def test_a_static_address_of_a_machine() -> None:
    """Of static addresses only those count that pods get."""
    network = Network(mode="macvlan", ipam="static", subnet="10.66.0.0/24")
    item = nad(ipam={"type": "static"}, **IPS)
    good = found(item, workload(networks=static("10.66.0.50/24")), network=network)
    assert good == []
    bad = found(item, workload(networks=static("10.66.0.11/24")), network=network)
    assert [f.message for f in bad] == [
        "pods would get addresses that machines have: 10.66.0.11 (node1)"
    ]


@pytest.mark.parametrize(
    ("item", "size", "range_text"),
    [
        (whereabouts("10.77.0.0/29"), 6, "10.77.0.1 to 10.77.0.6"),
        (whereabouts("10.77.0.0/24", range_end="10.77.0.4"), 4, "10.77.0.1 to 10.77.0.4"),
        (
            whereabouts("10.77.0.0/29", exclude=["10.77.0.4/30", "10.77.0.5/32"]),
            3,
            "10.77.0.1 to 10.77.0.6",
        ),
        (whereabouts("10.77.0.2-10.77.0.5/29"), 4, "10.77.0.2 to 10.77.0.5"),
    ],
)
def test_too_few_addresses(item: dict[str, Any], size: int, range_text: str) -> None:
    """More pods than addresses, as whereabouts counts them."""
    subnet = read_attachment(item).ranges[0].subnet
    assert texts(found(item, workload(replicas=7))) == [
        f"error rigelfile too-few-addresses: 7 pods need an address, and {subnet} has {size} to"
        f" give out ({range_text}) => use a larger `network.subnet`, or a larger range in"
        " `range_start` and `range_end`"
    ]
    assert found(item, workload(replicas=size)) == []


def test_the_smallest_of_several_ranges_decides() -> None:
    """A pod gets one address of each range."""
    ranges = {"ipRanges": [{"range": "10.78.0.0/24"}, {"range": "10.79.0.0/30"}]}
    item = nad(ipam={"type": "whereabouts", "range": "10.77.0.0/24", **ranges})
    assert [f.message for f in found(item, workload(replicas=3))] == [
        "3 pods need an address, and 10.79.0.0/30 has 2 to give out (10.79.0.1 to 10.79.0.2)"
    ]
    assert found(item, workload(replicas=2)) == []


def test_static_without_room() -> None:
    """Static addresses come from the Rigelfile's subnet, which must have enough of them."""
    network = Network(
        mode="macvlan", ipam="static", subnet="10.77.0.0/24", range_start="10.77.0.250"
    )
    item = nad(ipam={"type": "static"}, **IPS)
    pods = [workload(f"n{i}", networks=static(f"10.77.0.{240 + i}/24")) for i in range(6)]
    assert [f.message for f in found(item, *pods, network=network)] == [
        "6 pods need an address, and 10.77.0.0/24 has 5 to give out (10.77.0.250 to 10.77.0.254)"
    ]


def test_ipv6_ranges_are_ranges() -> None:
    """An IPv6 range beside IPv4 networks of the cluster is compared with its own kind."""
    assert found(whereabouts("fd00:77::/64"), workload()) == []
    seen = view(services=[ip_network("fd00:77::/112")])
    kinds = [f.kind for f in found(whereabouts("fd00:77::/64"), workload(), seen=seen)]
    assert kinds == ["service-network"]


def test_a_node_without_a_pod_network() -> None:
    """Some networks give no ranges to nodes: then none is known."""
    bare = node("node1")
    bare["spec"] = {}
    assert found(seen=view(nodes=[bare])) == []


def test_findings_come_all_at_once() -> None:
    """What is wrong is told together, not one after the other."""
    item = nad(master="eth5", ipam={"type": "whereabouts", "range": "10.64.2.0/30"})
    assert [f.kind for f in found(item, workload(replicas=9))] == [
        "interface-missing",
        "pod-network",
        "too-few-addresses",
    ]

"""Addresses that collide or run out: each finding with its words."""

from __future__ import annotations

from ipaddress import ip_network
from typing import Any

import attrs
import pytest

from rigel_k8s.network.options import Network
from rigel_k8s.network.preflight.attachments import attachment
from rigel_k8s.network.preflight.machine import Route

from .cases import addresses, found, machine, nad, node, texts, view, workload

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


def test_an_attachment_that_gives_no_address_that_is_asked_for() -> None:
    """Static addresses over an attachment that is there: it must pass them on."""
    network = Network(
        mode="attachment", attachment="nets/lab", ipam="static", subnet="10.77.0.0/24"
    )
    pods = [
        workload(
            name, networks=f'[{{"name": "lab", "namespace": "nets", "ips": ["10.77.0.{end}/24"]}}]'
        )
        for name, end in (("talker", 5), ("listener", 6))
    ]

    def with_lab(**config: Any) -> list[str]:
        there = attachment(nad("lab", "nets", **config))
        seen = view(attachments={there.key: there})
        return texts(found(*pods, seen=seen, network=network))

    why = (
        "error rigelfile attachment-addresses: NetworkAttachmentDefinition nets/lab does not give"
        " pods the addresses that they request:"
    )
    remedy = (
        ' => use an attachment with `"ipam": {"type": "static"}` and `"capabilities": {"ips":'
        " true}`, or remove `ipam: static` from the Rigelfile"
    )
    assert with_lab(ipam={"type": "static"}) == [
        f'{why} `"capabilities": {{"ips": true}}` is missing in its configuration{remedy}'
    ]
    assert with_lab(**IPS) == [f"{why} it takes addresses from whereabouts{remedy}"]
    assert with_lab(ipam={"type": "static"}, **IPS) == []
    network = attrs.evolve(network, range_start="10.77.0.5", range_end="10.77.0.5")
    kinds = [line.split(":")[0] for line in with_lab(ipam={"type": "static"}, **IPS)]
    assert kinds == ["error rigelfile too-few-addresses"]


def test_the_gateway() -> None:
    """whereabouts gives out the gateway's address, unless it is excluded."""
    assert texts(found(whereabouts("10.77.0.0/24", gateway="10.77.0.1"), workload())) == [
        "error rigelfile gateway-address: a pod would get the gateway's address, 10.77.0.1 => "
        + KEEP_OFF
    ]
    kept = whereabouts("10.77.0.0/24", gateway="10.77.0.1", exclude=["10.77.0.1/32"])
    assert found(kept, workload()) == []


def test_a_range_that_machines_reach_elsewhere() -> None:
    """A machine's network at another interface: pods would look for it at theirs. A warning."""
    facts = machine(routes=(*machine().routes, Route("eth1", ip_network("10.77.0.0/25"))))
    seen = view(machines={"node1": facts, "node2": machine()})
    assert texts(found(seen=seen)) == [
        "warning cluster route: node1 reaches 10.77.0.0/25 through eth1, and subnet"
        " 10.77.0.0/24 overlaps it: pods would look for it on eth0 => use another"
        " `network.subnet`, unless both interfaces are on one segment"
    ]


def test_a_route_to_a_single_address_is_no_network() -> None:
    """A /32 route inside of the subnet, as VPNs and pod networks set, warns of nothing."""
    facts = machine(routes=(*machine().routes, Route("eth1", ip_network("10.77.0.7/32"))))
    assert found(seen=view(machines={"node1": facts, "node2": machine()})) == []


def test_host_local_on_several_machines() -> None:
    """host-local knows one machine: two pods on two of them would get one address."""
    item = nad(ipam={"type": "host-local", "ranges": [[{"subnet": "10.77.0.0/24"}]]})
    assert texts(found(item, workload(), workload("listener"))) == [
        "error rigelfile host-local: host-local gives out addresses on each machine"
        " independently, and pods may run on node1, node2: two of them would get the same"
        " address => use `ipam: whereabouts`, or keep all pods on one machine with"
        " `placement.node`"
    ]
    off = node("node2", ready=False)
    off["spec"]["taints"] = [{"key": "node.kubernetes.io/unreachable", "effect": "NoSchedule"}]
    seen = view(nodes=[node("node1"), off])  # it will be back
    assert [f.kind for f in found(item, workload(replicas=2), seen=seen)] == ["host-local"]
    pinned = {"nodeSelector": {"kubernetes.io/hostname": "node1"}}
    assert found(item, workload(**pinned), workload("listener", **pinned)) == []
    assert found(item, workload()) == []


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
    subnet = attachment(item).ranges[0].subnet
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

"""Small buffers, and policies that do not reach: warnings with their words."""

from __future__ import annotations

from typing import Any

from rigel_k8s.network.options import Network
from rigel_k8s.network.preflight.machine import MachineFacts

from .cases import found, machine, nad, texts, view, with_interface, workload

HOST = workload(networks=None, hostNetwork=True)


def settings(**values: int) -> MachineFacts:
    names = {f"net.core.{name}": value for name, value in values.items()}
    return machine(settings={**machine().settings, **names})


def test_small_buffers() -> None:
    """Linux' usual 208 KiB lose a message of 1 MB; the command and its file are told."""
    seen = view(machines={"node1": settings(rmem_max=212992), "node2": machine()})
    assert texts(found(seen=seen)) == [
        "warning cluster small-buffers: messages of 1 MB and more may be lost on node1:"
        " net.core.rmem_max 212992 => run `sysctl -w net.core.rmem_max=8388608"
        " net.core.wmem_max=8388608` on the machine (not in a pod), and write it to"
        " /etc/sysctl.d/60-ros.conf"
    ]


def test_buffers_that_could_not_be_seen() -> None:
    """A machine that hides its limits is not called small."""
    seen = view(machines={"node1": machine(settings={}), "node2": machine()})
    assert found(seen=seen) == []


def test_a_table_of_neighbours_that_many_pods_share() -> None:
    """Every pod keeps every other one, and all pods of a machine have one table."""
    name = "net.ipv4.neigh.default.gc_thresh3"
    small = machine(settings={**machine().settings, name: 1024})
    seen = view(machines={"node1": small, "node2": machine()})
    assert texts(found(nad(), workload(replicas=50), seen=seen)) == [
        "warning cluster neighbours: 50 pods on 2 machines that send to each other need about"
        " 1225 neighbors on each, and node1 can keep 1024 (net.ipv4.neigh.default.gc_thresh3)"
        " for all pods together: packets to others are dropped silently => run `sysctl -w"
        " net.ipv4.neigh.default.gc_thresh3=4900` on the machine, and write it to"
        " /etc/sysctl.d/60-ros.conf"
    ]
    assert found(nad(), workload(replicas=45), seen=seen) == []


def test_fragments_by_radio() -> None:
    """On the machine's own network by radio, lost fragments block large messages."""
    radio = with_interface("wlan0", wireless=True)
    seen = view(machines={"node1": radio, "node2": machine()})
    assert texts(found(HOST, seen=seen, network=Network(mode="host"))) == [
        "warning cluster fragments: on the wireless network of node1, lost fragments may block"
        " large messages for 30 s => run `sysctl -w net.ipv4.ipfrag_time=3"
        " net.ipv4.ipfrag_high_thresh=134217728` on the machine, and write it to"
        " /etc/sysctl.d/60-ros.conf"
    ]
    assert found(HOST, network=Network(mode="host")) == []


def policy(**selector: Any) -> dict[str, Any]:
    return {"metadata": {"name": "deny", "namespace": "robot"}, "spec": {"podSelector": selector}}


def test_a_policy_that_does_not_reach() -> None:
    """A policy that selects our pods does not cover net1, and that is told."""
    expected = (
        "warning cluster network-policy: NetworkPolicy deny selects pods of this release and"
        " does not cover the second interface => every device on that network reaches all"
        " their ports: separate it with a VLAN or the machines' firewall, or use"
        " MultiNetworkPolicy"
    )
    assert texts(found(seen=view(policies=[policy()]))) == [expected]
    chosen = policy(matchLabels={"app": "talker"})
    assert texts(found(seen=view(policies=[chosen]))) == [expected]
    among = policy(matchExpressions=[{"key": "app", "operator": "In", "values": ["talker"]}])
    assert texts(found(seen=view(policies=[among]))) == [expected]
    others = policy(matchLabels={"app": "database"})
    assert found(seen=view(policies=[others])) == []


def test_a_policy_over_the_machines_network() -> None:
    """Nor does it cover the machine's own network."""
    found_here = found(HOST, seen=view(policies=[policy()]), network=Network(mode="host"))
    assert texts(found_here) == [
        "warning cluster network-policy: NetworkPolicy deny selects pods of this release and"
        " does not cover the machine's network (`mode: host`) => every device on that network"
        " reaches all their ports: separate it with a VLAN or the machines' firewall"
    ]


def test_findings_come_all_at_once() -> None:
    """What is wrong is told together, not one after the other."""
    item = nad(master="eth5", ipam={"type": "whereabouts", "range": "10.64.2.0/30"})
    seen = view(policies=[policy()])
    assert [f.kind for f in found(item, workload(replicas=9), seen=seen)] == [
        "interface-missing",
        "pod-network",
        "too-few-addresses",
        "network-policy",
    ]

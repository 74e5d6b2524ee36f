"""Policies that do not reach: warnings with their words."""

from __future__ import annotations

from typing import Any

from rigel_k8s.network.options import Network

from .cases import found, nad, texts, view, workload

HOST = workload(networks=None, hostNetwork=True)


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

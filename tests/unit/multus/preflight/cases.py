"""Clusters and releases for the checks: a machine as it was, and what a test changes of it."""

from __future__ import annotations

import json
from ipaddress import ip_address
from pathlib import Path
from typing import Any

import attrs

from rigel_k8s.network.options import Network
from rigel_k8s.problems import Problem
from rigel_multus.preflight.attachments import read_attachment
from rigel_multus.preflight.case import Case, ClusterView, find_wanted
from rigel_multus.preflight.checks import KINDS, find_problems
from rigel_multus.preflight.machine import Daemon, Interface, MachineFacts, parse

MACHINES = Path(__file__).parent / "machines"
NAMESPACE = "robot"


def machine(**changes: Any) -> MachineFacts:
    """A machine of the local cluster, recorded there."""
    recorded = parse((MACHINES / "node2.txt").read_text("utf-8"))
    return attrs.evolve(recorded, **changes)


def with_interface(name: str = "eth0", **changes: Any) -> MachineFacts:
    """That machine with one interface more, or another."""
    plain = machine()
    base = plain.interfaces.get(name, Interface(name))
    return attrs.evolve(plain, interfaces={**plain.interfaces, name: attrs.evolve(base, **changes)})


def node(name: str, *, ready: bool = True, **more: Any) -> dict[str, Any]:
    """A node as the API tells it; nodeN has the pod network 10.64.N.0/24 and address 10.66.0.1N."""
    number = name[-1]
    return {
        "metadata": {"name": name, "labels": {"kubernetes.io/hostname": name, **more}},
        "spec": {"podCIDRs": [f"10.64.{number}.0/24"]},
        "status": {
            "conditions": [{"type": "Ready", "status": "True" if ready else "Unknown"}],
            "addresses": [{"type": "InternalIP", "address": f"10.66.0.1{number}"}],
        },
    }


def nad(
    name: str = "lan", namespace: str = NAMESPACE, ipam: dict[str, Any] | None = None, **more: Any
) -> dict[str, Any]:
    """A NetworkAttachmentDefinition, macvlan on eth0 unless told otherwise."""
    config = {
        "cniVersion": "0.3.1",
        "type": "macvlan",
        "master": "eth0",
        "ipam": ipam or {"type": "whereabouts", "range": "10.77.0.0/24"},
        **more,
    }
    return {
        "apiVersion": "k8s.cni.cncf.io/v1",
        "kind": "NetworkAttachmentDefinition",
        "metadata": {"name": name, "namespace": namespace},
        "spec": {"config": json.dumps(config)},
    }


def workload(
    name: str = "talker", networks: str | None = "lan", replicas: int | None = None, **spec: Any
) -> dict[str, Any]:
    """A Deployment whose pods ask for networks."""
    annotations = {"k8s.v1.cni.cncf.io/networks": networks} if networks else {}
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {"name": name, "namespace": NAMESPACE},
        "spec": {
            **({} if replicas is None else {"replicas": replicas}),
            "template": {
                "metadata": {"labels": {"app": name}, "annotations": annotations},
                "spec": spec,
            },
        },
    }


def view(**changes: Any) -> ClusterView:
    """Two machines, alike, with Multus on both."""
    daemons = {
        name: Daemon(name, "kube-system", f"multus-{name}", "kube-multus")
        for name in ("node1", "node2")
    }
    plain = ClusterView(
        nodes=[node("node1"), node("node2")],
        daemons=daemons,
        machines={"node1": machine(), "node2": machine()},
    )
    return attrs.evolve(plain, **changes)


def found(
    *objects: dict[str, Any],
    seen: ClusterView | None = None,
    network: Network | None = None,
) -> list[Problem]:
    """What is found where objects (default: a workload and its macvlan) meet a cluster."""
    items = list(objects) or [nad(), workload()]
    own = [read_attachment(item) for item in items if item["kind"] == "NetworkAttachmentDefinition"]
    return find_problems(
        Case(
            network or Network(mode="macvlan"),
            list(find_wanted(items)),
            {one.key: one for one in own},
            seen or view(),
        )
    )


def texts(findings: list[Problem]) -> list[str]:
    """How findings are told: SEVERITY FAULT KIND: MESSAGE => REMEDY."""
    return [
        f"{f.severity} {'rigelfile' if KINDS[f.kind].changes == 'Rigelfile' else 'cluster'}"
        f" {f.kind}: {f.message} => {f.remedy}"
        for f in findings
    ]


def addresses(*items: str) -> frozenset[Any]:
    return frozenset(ip_address(item) for item in items)

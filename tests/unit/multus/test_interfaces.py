"""Pods that run without a network that they asked for."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_multus.interfaces import (
    InterfaceRequest,
    find_without_interface,
    list_requests,
    requests_of,
)

ETH0 = {"name": "cbr0", "interface": "eth0", "default": True}


def pod(networks: Any = None, status: Any = None, phase: str = "Running", **meta: Any) -> Any:
    """Return a pod with annotations as given."""
    notes = {}
    if networks is not None:
        text = networks if isinstance(networks, str) else json.dumps(networks)
        notes["k8s.v1.cni.cncf.io/networks"] = text
    if status is not None:
        notes["k8s.v1.cni.cncf.io/network-status"] = json.dumps(status)
    return {
        "metadata": {"name": "talker", "namespace": "lab", "annotations": notes, **meta},
        "spec": {"nodeName": "robot"},
        "status": {"phase": phase},
    }


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("lan", ["lab/lan"]),
        ("lan, other/wan@net7", ["lab/lan", "other/wan"]),
        ([{"name": "lan"}, {"name": "wan", "namespace": "other"}], ["lab/lan", "other/wan"]),
        ("lan,lan", ["lab/lan", "lab/lan"]),
        ("", []),
        ("[not json", []),
    ],
)
def test_asked(text: Any, names: list[str]) -> None:
    """Both forms of the annotation are read, names without a namespace are the pod's own."""
    assert [request.key for request in requests_of(pod(text))] == names


def test_addresses() -> None:
    """Static addresses are read as they are written."""
    text = '[{"name": "x", "namespace": "lab", "ips": ["10.1.0.5/24"]}]'
    requests = list_requests({"k8s.v1.cni.cncf.io/networks": text}, "robot")
    assert requests == [InterfaceRequest("lab/x", ("10.1.0.5/24",))]


@pytest.mark.parametrize(
    "fine",
    [
        pod(),
        pod("lan", [ETH0, {"name": "lab/lan", "interface": "net1"}]),
        pod("lan", None, phase="Pending"),
        pod("lan", None, phase="Succeeded"),
        pod("lan", [ETH0], deletionTimestamp="2026-01-01T00:00:00Z"),
    ],
)
def test_pods_that_lack_nothing(fine: Any) -> None:
    """Nothing is told of pods that have what they asked for, or do not run (yet, any more)."""
    assert find_without_interface([fine]) == []


@pytest.mark.parametrize(
    ("one", "lacking"),
    [
        (pod("lan", [ETH0]), ("lab/lan",)),
        (pod("lan"), ("lab/lan",)),
        (pod("lan,lan", [ETH0, {"name": "lab/lan", "interface": "net1"}]), ("lab/lan",)),
        (pod("lan,other/wan", [ETH0, {"name": "lab/lan"}]), ("other/wan",)),
    ],
)
def test_pods_that_lack_a_network(one: Any, lacking: tuple[str, ...]) -> None:
    """A running pod is named with its node and each network that it has not got."""
    (missing,) = find_without_interface([one])
    assert (missing.pod, missing.node, missing.networks) == ("talker", "robot", lacking)
    assert str(missing).startswith("pod lab/talker on robot runs without its network ")

"""Preflight where Multus, or a CNI program, lacks: on a cluster that a test may break."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from typing import Any

import pytest

from rigel_k8s.network.options import Install, Network
from rigel_k8s.release.types import DeployOptions
from rigel_multus.install import install
from rigel_multus.preflight.examine import examine

pytestmark = pytest.mark.cluster

NETWORK = Network(mode="macvlan", interface="eth0", subnet="10.202.0.0/24")


def objects(namespace: str, program: str = "macvlan") -> list[dict[str, Any]]:
    """A workload and its attachment."""
    config = {
        "cniVersion": "0.3.1",
        "name": "lan",
        "type": program,
        "master": "eth0",
        "ipam": {"type": "whereabouts", "range": "10.202.0.0/24"},
    }
    meta = {"name": "lan", "namespace": namespace}
    networks = {"annotations": {"k8s.v1.cni.cncf.io/networks": "lan"}}
    return [
        {
            "apiVersion": "k8s.cni.cncf.io/v1",
            "kind": "NetworkAttachmentDefinition",
            "metadata": meta,
            "spec": {"config": json.dumps(config)},
        },
        {
            "apiVersion": "apps/v1",
            "kind": "Deployment",
            "metadata": {"name": "talker", "namespace": namespace},
            "spec": {"template": {"metadata": networks, "spec": {}}},
        },
    ]


def told(cluster: Any, *made: dict[str, Any]) -> list[str]:
    found = examine(made, NETWORK, cluster)
    return [f"{f.kind}: {f.message}" for f in found]


@pytest.fixture
def hidden(own: Any) -> Iterator[Any]:
    """Take a CNI program of node2 away, where nobody brings it back: hidden("macvlan")."""
    moved = []
    own.signal_keepers("node2", signal.SIGSTOP)

    def hide(program: str) -> None:
        path = own.programs("node2") / program
        aside = path.with_name(f".{program}.aside")
        path.rename(aside)
        moved.append((aside, path))

    yield hide
    for aside, path in moved:
        aside.rename(path)
    own.signal_keepers("node2", signal.SIGCONT)


def test_its_remedy_helps(own: Any, said: Any) -> None:
    """After `network install` nothing is found; k3s' own programs, absolute links into a directory
    with a hash, are seen below the machine's root."""
    install(own.cluster, Install(), DeployOptions(report=said))
    assert told(own.cluster, *objects("default")) == []
    assert told(own.cluster, *objects("default", "bridge")) == []


def test_a_program_that_one_machine_lacks(own: Any, hidden: Any) -> None:
    """A CNI program that is gone from one machine is told with that machine and the directory."""
    directory = f"{own.data_dir}/data/cni" if own.data_dir else "/opt/cni/bin"
    hidden("bridge")
    assert told(own.cluster, *objects("default", "bridge")) == [
        f"program-missing: CNI programs are missing on node2: bridge (looked into {directory})"
    ]
    hidden("macvlan")
    assert told(own.cluster, *objects("default")) == [
        f"program-missing: CNI programs are missing on node2: macvlan (looked into {directory})"
    ]

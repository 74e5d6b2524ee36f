"""What is told where machines do not answer; the cluster's client is a stand-in here."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.execution import ExecResult
from rigel_k8s.network.options import Network
from rigel_k8s.objects.refs import ObjectRef
from rigel_multus.preflight.examine import examine

LINKS = """@links
eth0 0x1003 1500 -
@routes
@addresses
@end
"""
CONFIG = {"type": "macvlan", "master": "eth0", "ipam": {"type": "static"}}
OBJECTS: list[dict[str, Any]] = [
    {
        "kind": "NetworkAttachmentDefinition",
        "metadata": {"name": "lan", "namespace": "robot"},
        "spec": {"config": json.dumps(CONFIG)},
    },
    {
        "kind": "Deployment",
        "metadata": {"name": "talker", "namespace": "robot"},
        "spec": {"template": {"metadata": {"annotations": {"k8s.v1.cni.cncf.io/networks": "lan"}}}},
    },
]


def pod_of(node: str) -> dict[str, Any]:
    owner = {"uid": "set", "controller": True}
    return {
        "metadata": {
            "name": f"multus-{node}",
            "namespace": "kube-system",
            "ownerReferences": [owner],
        },
        "spec": {
            "nodeName": node,
            "containers": [
                {
                    "name": "m",
                    "image": "multus-cni",
                    "volumeMounts": [{"name": "r", "mountPath": "/h"}],
                }
            ],
            "volumes": [{"name": "r", "hostPath": {"path": "/"}}],
        },
        "status": {"conditions": [{"type": "Ready", "status": "True"}]},
    }


class Cluster:
    """Two machines with Multus; how they answer is up to the test."""

    def __init__(self, answer: Callable[[str], ExecResult], off: str = "") -> None:
        self.answer, self.off = answer, off
        self.asked: list[list[str]] = []

    def parallel(self, function: Callable[[Any], Any], items: Any) -> list[Any]:
        return [function(item) for item in items]

    def gather(self, *calls: Callable[[], Any]) -> tuple[Any, ...]:
        return tuple(call() for call in calls)

    def serves(self, api_version: str, kind: str) -> bool:
        return True

    def nodes(self) -> list[dict[str, Any]]:
        return [
            {
                "metadata": {"name": name},
                "status": {"conditions": [{"type": "Ready", "status": str(name != self.off)}]},
            }
            for name in ("node1", "node2")
        ]

    def list(self, api_version: str, kind: str, *_: Any, **__: Any) -> list[dict[str, Any]]:
        volumes = [{"hostPath": {"path": "/etc/cni/net.d"}}]
        template = {"spec": {"containers": [{"image": "multus-cni"}], "volumes": volumes}}
        daemons = {
            "metadata": {"name": "x", "namespace": "kube-system", "uid": "set"},
            "spec": {"template": template, "selector": {}},
        }
        stranger = {**pod_of("node1"), "metadata": {"name": "else", "namespace": "kube-system"}}
        pods = [pod_of("node1"), pod_of("node2"), stranger]
        return {"DaemonSet": [daemons], "Pod": pods}.get(kind, [])

    def get(self, ref: ObjectRef) -> Any:
        return None

    def run(self, namespace: str, pod: str, command: list[str], **_: Any) -> ExecResult:
        self.asked.append([pod, *command[-2:]])
        return self.answer(pod)


def found(cluster: Cluster) -> list[str]:
    network = Network(mode="macvlan", ipam="static", subnet="10.9.0.0/24")
    findings = examine(OBJECTS, network, cluster)  # type: ignore[arg-type]
    return [f"{f.severity} {f.message}" for f in findings]


def said(text: str) -> ExecResult:
    return ExecResult(0, text.encode(), b"")


def test_each_machine_is_asked_once() -> None:
    """One exec into the daemon of each machine, with where its files are; no other pod is."""
    cluster = Cluster(lambda _: said(LINKS))
    assert found(cluster) == []
    expected = [[f"multus-{node}", "/h", "/h/opt/cni/bin"] for node in ("node1", "node2")]
    assert cluster.asked == expected


@pytest.mark.parametrize("text", ["", "@links\neth0 1 0x1003", "sh: not found"])
def test_an_answer_that_makes_no_sense(text: str) -> None:
    """A machine whose answer is cut short is told not to have been looked at; the others were."""
    cluster = Cluster(lambda pod: said(text if pod.endswith("2") else LINKS))
    (warning,) = found(cluster)
    assert warning == (
        "warning preflight could not check interfaces and CNI programs of node2 (the output of"
        " the script on the machine is incomplete)"
    )


def test_a_machine_that_does_not_answer() -> None:
    """A daemon that hangs costs seconds, and the deploy goes on."""

    def hang(pod: str) -> ExecResult:
        raise ClusterError(f"/bin/sh in Pod {pod} did not end within 10 s")

    (warning,) = found(Cluster(hang))
    assert warning.startswith("warning preflight could not check interfaces and")
    assert "of node1 (/bin/sh in Pod multus-node1 did not end within 10 s); interfaces" in warning


def test_a_machine_that_is_off() -> None:
    """A machine that is not ready is not asked, and told."""
    cluster = Cluster(lambda _: said(LINKS), off="node1")
    assert found(cluster) == ["warning preflight could not check node1 (not ready)"]
    assert [pod for pod, *_ in cluster.asked] == ["multus-node2"]


class Older(Cluster):
    """A cluster before Kubernetes 1.33, which does not list the ranges of Services."""

    def list(self, api_version: str, kind: str, *_: Any, **__: Any) -> list[dict[str, Any]]:
        if kind == "ServiceCIDR":
            raise ClusterError("the server could not find the requested resource")
        return super().list(api_version, kind)

    def get(self, ref: ObjectRef) -> Any:
        return {"spec": {"clusterIPs": ["10.9.0.1"]}} if ref.name == "kubernetes" else None


def test_without_a_list_of_services_the_address_of_one_counts() -> None:
    """The Service `kubernetes` has an address of their range."""
    (error,) = found(Older(lambda _: said(LINKS)))
    assert error.startswith("error subnet 10.9.0.0/24 overlaps the Services' network: 10.9.0.1/32")


class WithoutMultus(Cluster):
    """A cluster of two machines without Multus."""

    def list(self, api_version: str, kind: str, *_: Any, **__: Any) -> list[dict[str, Any]]:
        return []


def test_on_the_machines_network_without_multus_nothing_is_checked() -> None:
    """No machine is examined, not even for `interface`, and no warning says so."""
    cluster = WithoutMultus(lambda _: said(LINKS))
    pods = {"template": {"spec": {"hostNetwork": True}}}
    objects = [
        {"kind": "Deployment", "metadata": {"name": "a", "namespace": "robot"}, "spec": pods}
    ]
    network = Network(mode="host", interface="eth7")
    assert examine(objects, network, cluster) == []  # type: ignore[arg-type]
    assert cluster.asked == []

"""What a cluster is, from its nodes alone."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_k8s.network.options import Install
from rigel_multus.platform import group_by_platform, platform

K3S_BIN = "/var/lib/rancher/k3s/data/cni"
HASH = "3fcd4fcf3ae2ba4d577d4ee08ad7092538cd7a7f0da701efa2a8807d44a11f66"


def node(
    name: str = "robot",
    version: str = "v1.34.4",
    labels: dict[str, str] | None = None,
    provider: str = "",
    **annotations: Any,
) -> dict[str, Any]:
    """Return a node; annotations are k3s' and are given without their prefix."""
    notes = {f"k3s.io/{k.replace('_', '-')}": json.dumps(v) for k, v in annotations.items()}
    return {
        "metadata": {"name": name, "labels": labels or {}, "annotations": notes},
        "spec": {"providerID": provider} if provider else {},
        "status": {"nodeInfo": {"kubeletVersion": version}},
    }


def k3s(*words: str, version: str = "v1.34.4+k3s1", **more: Any) -> dict[str, Any]:
    """Return a node of k3s."""
    return node(version=version, node_args=list(words), **more)


@pytest.mark.parametrize(
    ("one", "kind", "conf", "programs"),
    [
        (node(), "plain", "/etc/cni/net.d", "/opt/cni/bin"),
        (node(provider="kind://docker/kind/kind-worker"), "kind", "/etc/cni/net.d", "/opt/cni/bin"),
        (
            node(labels={"minikube.k8s.io/name": "m"}),
            "minikube",
            "/etc/cni/net.d",
            "/opt/cni/bin",
        ),
        (
            node(labels={"microk8s.io/cluster": "true"}),
            "microk8s",
            "/var/snap/microk8s/current/args/cni-network",
            "/var/snap/microk8s/current/opt/cni/bin",
        ),
        (k3s("server"), "k3s", "/var/lib/rancher/k3s/agent/etc/cni/net.d", K3S_BIN),
        (node(version="v1.31.2+rke2r1"), "plain", "/etc/cni/net.d", "/opt/cni/bin"),
    ],
)
def test_kinds(one: dict[str, Any], kind: str, conf: str, programs: str) -> None:
    """Each kind of cluster is recognised, and where it keeps CNI's files."""
    (found,) = group_by_platform([one], Install())
    where = found.platform
    assert (where.kind, where.conf_dir, where.bin_dir) == (kind, conf, programs)


@pytest.mark.parametrize(
    "one",
    [
        k3s("agent", "--data-dir", "/data"),
        k3s("agent", "--data-dir=/data/"),
        k3s("agent", "-d", "/data"),
        k3s("agent", node_env={"K3S_DATA_DIR": f"/data/data/{HASH}"}),
        k3s("agent", node_env={"K3S_DATA_DIR": "/data"}),
    ],
)
def test_data_directories(one: dict[str, Any]) -> None:
    """Where k3s was given another data directory, as Eclipse Leda does, its node tells it."""
    (found,) = group_by_platform([one], Install())
    assert found.platform.conf_dir == "/data/agent/etc/cni/net.d"
    assert found.platform.bin_dir == "/data/data/cni"
    assert found.platform.roots == ("/data/data", "/data/agent/etc/cni/net.d")


def test_the_variable_of_a_release_is_no_data_directory() -> None:
    """k3s tells its processes by K3S_DATA_DIR where the release is unpacked; that is not it."""
    one = k3s("server", node_env={"K3S_DATA_DIR": f"/var/lib/rancher/k3s/data/{HASH}"})
    (found,) = group_by_platform([one], Install())
    assert found.platform.bin_dir == K3S_BIN


@pytest.mark.parametrize(
    ("version", "fixed"),
    [
        ("v1.27.16+k3s1", False),
        ("v1.28.14+k3s1", False),
        ("v1.28.15+k3s1", True),
        ("v1.29.9+k3s1", False),
        ("v1.29.10+k3s1", True),
        ("v1.30.5+k3s1", False),
        ("v1.30.6+k3s1", True),
        ("v1.31.1+k3s1", False),
        ("v1.31.2+k3s1", True),
        ("v1.32.0+k3s1", True),
        ("v2.0.0+k3s1", True),
    ],
)
def test_older_k3s_keeps_programs_with_the_release(version: str, *, fixed: bool) -> None:
    """The directory that stays came with the releases of October 2024."""
    (found,) = group_by_platform([k3s("server", version=version)], Install())
    end = "data/cni" if fixed else "data/current/bin"
    assert found.platform.bin_dir == f"/var/lib/rancher/k3s/{end}"
    assert found.platform.roots[0] == "/var/lib/rancher/k3s/data"


def test_what_is_said_is_believed() -> None:
    """Options win over what was recognised."""
    said = Install(platform="k3s", data_dir="/data", cni_bin_dir="/opt/own")
    (found,) = group_by_platform([node()], said)
    assert found.platform == platform("k3s", data_dir="/data", bin_dir="/opt/own")
    assert found.platform.roots == ("/data/agent/etc/cni/net.d", "/opt/own") or (
        found.platform.roots == ("/opt/own", "/data/agent/etc/cni/net.d")
    )


def test_a_cluster_of_several_kinds() -> None:
    """A k3s server on a laptop and robots with another data directory are two groups."""
    nodes = [
        {
            **k3s("agent", "--data-dir=/data"),
            "metadata": {**k3s("a", "--data-dir=/data")["metadata"], "name": f"robot{n}"},
        }
        for n in (2, 1)
    ]
    nodes.append({**k3s("server"), "metadata": {**k3s("server")["metadata"], "name": "laptop"}})
    first, second = group_by_platform(nodes, Install())
    assert (first.nodes, first.platform.bin_dir) == (("robot1", "robot2"), "/data/data/cni")
    assert (second.nodes, second.platform.bin_dir) == (("laptop",), K3S_BIN)


def test_only_linux_counts() -> None:
    """A node of another system gets no Multus."""
    assert group_by_platform([node(labels={"kubernetes.io/os": "windows"})], Install()) == ()

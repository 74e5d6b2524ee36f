"""Multus is recognised whoever installed it, and so is where its container has the machine."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.network.multus.installation import runs
from rigel_k8s.network.preflight.machine import Daemon, read_daemon

READY = {"conditions": [{"type": "Ready", "status": "True"}]}


def pod(*containers: dict[str, Any], volumes: dict[str, str], status: Any = None) -> dict[str, Any]:
    listed = [{"name": name, "hostPath": {"path": path}} for name, path in volumes.items()]
    return {
        "metadata": {"namespace": "kube-system", "name": "multus-x"},
        "spec": {
            "nodeName": "node1",
            "containers": list(containers),
            "volumes": [*listed, {"name": "config", "configMap": {"name": "c"}}],
        },
        "status": READY if status is None else status,
    }


def container(name: str, image: str, mounts: dict[str, str], **env: str) -> dict[str, Any]:
    return {
        "name": name,
        "image": image,
        "env": [{"name": key, "value": value} for key, value in env.items()],
        "volumeMounts": [{"name": volume, "mountPath": path} for volume, path in mounts.items()]
        + [{"name": "config", "mountPath": "/etc/multus"}],
    }


OURS = pod(
    container(
        "multus",
        "ghcr.io/k8snetworkplumbingwg/multus-cni:v4.3.0-thick",
        {"machine": "/hostroot", "root-0": "/var/lib/rancher/k3s"},
    ),
    container("machine", "multus-cni:1", {}, BIN_DIR="/var/lib/rancher/k3s/data/cni"),
    volumes={"machine": "/", "root-0": "/var/lib/rancher/k3s"},
)
UPSTREAM = pod(
    container(
        "kube-multus",
        "ghcr.io/k8snetworkplumbingwg/multus-cni:snapshot-thick",
        {"cni": "/host/etc/cni/net.d", "cnibin": "/opt/cni/bin", "hostroot": "/hostroot"},
    ),
    volumes={"cni": "/etc/cni/net.d", "cnibin": "/opt/cni/bin", "hostroot": "/"},
)
MICROK8S = pod(  # its addon runs the thin one
    container(
        "kube-multus",
        "ghcr.io/k8snetworkplumbingwg/multus-cni:v3.9",
        {"cni": "/host/etc/cni/net.d", "cnibin": "/host/opt/cni/bin"},
    ),
    volumes={
        "cni": "/var/snap/microk8s/current/args/cni-network",
        "cnibin": "/var/snap/microk8s/current/opt/cni/bin",
    },
)
OLD_K3S = pod(
    container(
        "kube-rke2-multus", "rancher/hardened-multus-cni:v4", {"cnibin": "/host/opt/cni/bin"}
    ),
    volumes={"cnibin": "/var/lib/rancher/k3s/data/current/bin"},
)
UNUSUAL = pod(
    container("daemon", "registry.lab/multus@sha256:00", {"host": "/host/"}), volumes={"host": "/"}
)


@pytest.mark.parametrize(
    ("made", "name", "root", "directory"),
    [
        (OURS, "multus", "/hostroot", "/hostroot/var/lib/rancher/k3s/data/cni"),
        (UPSTREAM, "kube-multus", "/hostroot", "/hostroot/opt/cni/bin"),
        (MICROK8S, "kube-multus", "", "/host/opt/cni/bin"),
        (OLD_K3S, "kube-rke2-multus", "", "/host/opt/cni/bin"),
        (UNUSUAL, "daemon", "/host/", "/host/opt/cni/bin"),
    ],
    ids=["ours", "upstream", "microk8s", "old k3s", "unusual"],
)
def test_where_the_machine_is(made: dict[str, Any], name: str, root: str, directory: str) -> None:
    """The container, the machine's root directory in it, and its CNI programs."""
    expected = Daemon("node1", "kube-system", "multus-x", name, root=root, directories=(directory,))
    assert read_daemon(made) == expected


@pytest.mark.parametrize(
    ("status", "state"),
    [
        (READY, ""),
        ({"phase": "Pending"}, "Pending"),
        ({}, "not ready"),
        (
            {
                "phase": "Running",
                "conditions": [{"type": "Ready", "status": "False"}],
                "containerStatuses": [{"state": {"waiting": {"reason": "CrashLoopBackOff"}}}],
            },
            "CrashLoopBackOff",
        ),
    ],
)
def test_why_it_is_not_ready(status: dict[str, Any], state: str) -> None:
    """The reason that Kubernetes has for it."""
    made = pod(container("multus", "multus-cni:1", {}), volumes={}, status=status)
    assert read_daemon(made).state == state


@pytest.mark.parametrize(
    ("name", "image", "expected"),
    [
        ("kube-multus-ds", "registry.lab:5000/cni:4", True),
        ("rke2-multus", "rancher/hardened-multus-cni:v4.2@sha256:00", True),
        ("rigel-whereabouts", "registry.lab/multus/whereabouts:v0.9.4", False),
        ("kube-proxy", "kube-proxy:1", False),
    ],
)
def test_which_daemon_sets_are_multus(name: str, image: str, *, expected: bool) -> None:
    """By its name or its image's, not by the registry that the image is in."""
    volumes = [{"name": "cni", "hostPath": {"path": "/etc/cni/net.d"}}]
    template = {"spec": {"containers": [{"name": "x", "image": image}], "volumes": volumes}}
    made = {"metadata": {"name": name}, "spec": {"template": template}}
    assert runs("multus", made) is expected

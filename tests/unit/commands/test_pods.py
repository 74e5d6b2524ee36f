"""What a pod object says about its ROS node."""

from __future__ import annotations

import socket
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.commands import pods
from rigel_k8s.commands.logs.history import run_of
from rigel_k8s.commands.pods import choose_running, pod_of, wrap_command
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.target import Target
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from tests.support.http_server import Exchange, serving


def pod(
    name: str = "lab-arm-1", *, ready: bool = True, phase: str = "Running", **more: Any
) -> dict[str, Any]:
    return {
        "metadata": {
            "name": name,
            "namespace": "lab",
            "labels": {"app.kubernetes.io/name": "lab-arm"},
            "annotations": {"rigel-k8s/ros-name": "/lab/arm", "rigel-k8s/node": "lab/arm"},
            "creationTimestamp": "2026-01-01T00:00:00Z",
            **more,
        },
        "spec": {
            "containers": [
                {"name": "ros-node", "volumeMounts": [{"name": "s", "mountPath": "/rigel-k8s"}]},
                {"name": "sidecar"},
            ]
        },
        "status": {
            "phase": phase,
            "conditions": [{"type": "Ready", "status": str(ready)}],
        },
    }


def test_all_names_of_a_node() -> None:
    """Its key, its ROS name, its Kubernetes name, its pod."""
    assert pod_of(pod()).aliases == {"lab/arm", "/lab/arm", "lab-arm", "lab-arm-1"}


def test_commands_get_ros_where_our_scripts_are() -> None:
    """A container that is not of our making gets the command as it is."""
    ours = pod()
    assert wrap_command(pod_of(ours), ["ls"]) == ["/bin/sh", "/rigel-k8s/exec.sh", "ls"]
    assert wrap_command(pod_of(ours), []) == ["/bin/sh", "/rigel-k8s/exec.sh"]
    del ours["spec"]["containers"][0]["volumeMounts"]
    assert wrap_command(pod_of(ours), ["ls"]) == ["ls"]
    assert wrap_command(pod_of(ours), []) == ["/bin/sh"]


def test_the_pod_to_work_in_is_a_ready_one() -> None:
    """In a roll-out there are several; one that ends is none of them."""
    gone = pod("a", deletionTimestamp="2026-01-01T00:00:09Z")
    found = [pod_of(p) for p in (gone, pod("b", ready=False), pod("c"), pod("d", phase="Pending"))]
    assert choose_running(found).name == "c"
    with pytest.raises(UserError, match="no pod of lab-arm runs: d is Pending"):
        choose_running([found[0], found[3]])


def test_a_run_of_a_container_has_a_number() -> None:
    """Each run has a log of its own; one that has not started has none."""
    item = pod()
    assert run_of(item) is None
    states = [
        {"name": "sidecar", "restartCount": 9, "state": {"running": {}}},
        {"name": "ros-node", "restartCount": 2, "state": {"waiting": {}}},
    ]
    item["status"]["containerStatuses"] = states
    assert run_of(item) is None
    states[1]["state"] = {"running": {}}
    assert run_of(item) == 2


def test_a_forward_without_the_right_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first connection shows it; the error names the right."""
    missing = 'User "ann" cannot get resource "pods/portforward" in API group "" in "lab"'

    def answer(exchange: Exchange) -> None:
        if exchange.request_.path.endswith("/portforward"):
            exchange.say(403, {"kind": "Status", "message": missing})
        else:
            exchange.say(200, {"metadata": {}, "items": [pod()]})

    with serving(answer) as server:
        found = Release(Cluster(Target(server.url)), ReleaseId("lab", "lab"))
        monkeypatch.setattr(pods, "release", lambda *_: found)
        monkeypatch.setattr(pods, "LOOK", 0.01)
        lines = pods.forward(Settings(Path("Rigelfile")), "lab/arm", {7000: 0})
        local = int(next(lines).partition(" ")[0].rpartition(":")[2])
        refused = pytest.raises(ClusterError, match="pods/portforward")
        with socket.create_connection(("127.0.0.1", local)), refused as raised:
            next(lines)
        assert raised.value.exit_code == 1

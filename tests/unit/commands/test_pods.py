"""What a pod object says about its ROS node."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.commands import pods
from rigel_k8s.commands.logs.reading import run_of
from rigel_k8s.commands.pods import (
    choose_running,
    explain_forward,
    find_matching,
    no_node_error,
    pod_of,
    wrap_command,
)
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


def test_what_runs_once_has_no_deployment() -> None:
    """It can be restarted, and neither developed nor replaced."""
    of_job = {"kind": "Job", "name": "lab-arm", "uid": "1", "controller": True}
    task = pod_of(pod(ownerReferences=[of_job]))
    assert (task.owner.kind, task.owner.api_version) == ("Job", "batch/v1")
    with pytest.raises(UserError, match=r"lab-arm runs once .* cannot be developed") as caught:
        task.find_deployment("developed")
    assert caught.value.hint == "`rigel restart lab-arm` runs it again"
    assert pod_of(pod()).find_deployment("developed").kind == "Deployment"


def test_all_names_of_a_node() -> None:
    """Its key, its ROS name, its Kubernetes name, its pod."""
    assert pod_of(pod()).aliases == {"lab/arm", "/lab/arm", "lab-arm", "lab-arm-1"}


def test_a_name_without_its_namespace_means_the_only_such_node() -> None:
    """As `listener` for `lab/listener`; of two, neither is meant."""
    arm = pod_of(pod())
    other = attrs.evolve(arm, name="x", workload="other-arm", ros_name="/other/arm")
    assert find_matching([arm], "arm") == [arm]
    assert find_matching([arm, other], "arm") == []
    assert find_matching([arm], "ar") == []


def test_a_misspelt_name_of_any_kind_leads_to_the_right_one() -> None:
    """Beside the name in the Rigelfile, a node has its ROS name."""
    for wrong, right in (("lab-ram", "lab-arm"), ("/lab/amr", "/lab/arm"), ("lab/amr", "lab/arm")):
        error = no_node_error(
            Release(Cluster(Target("http://127.0.0.1:1")), ReleaseId("lab", "x")),
            wrong,
            [pod_of(pod())],
        )
        assert error.message == f'no pod of a node "{wrong}", did you mean "{right}"?'


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


def forward_lines(monkeypatch: pytest.MonkeyPatch, *ports: dict[str, Any]) -> Iterator[str]:
    """Yield what a forward without a port prints for a pod with these ports."""
    item = pod()
    item["spec"]["containers"][0]["ports"] = list(ports)
    with serving(lambda exchange: exchange.say(200, {"metadata": {}, "items": [item]})) as server:
        found = Release(Cluster(Target(server.url)), ReleaseId("lab", "lab"))
        monkeypatch.setattr(pods, "release", lambda *_: found)
        yield from pods.forward(Settings(Path("Rigelfile")), "lab/arm", {})


def test_a_forward_without_a_port_takes_the_only_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """UDP cannot be forwarded; for the bridge it prints what opens the viewers."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    udp = {"containerPort": 9, "protocol": "UDP"}
    lines = forward_lines(monkeypatch, {"containerPort": port, "name": "foxglove"}, udp)
    address = f"ws://127.0.0.1:{port}"
    assert [next(lines), next(lines), next(lines)] == [
        f"127.0.0.1:{port} -> lab-arm-1:{port}",
        f"Foxglove: https://app.foxglove.dev/~/view?ds=foxglove-websocket&ds.url={address}",
        f"or open {address} in Lichtblick or another viewer",
    ]
    lines.close()  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("ports", "message"),
    [((), "lab-arm has no `ports`"), ((1, 2), "lab-arm has the ports 1, 2")],
)
def test_a_forward_that_needs_a_port_asks_for_it(
    ports: tuple[int, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error has the ports that there are."""
    with pytest.raises(UserError, match=message) as raised:
        next(forward_lines(monkeypatch, *({"containerPort": port} for port in ports)))
    assert raised.value.hint == "name the port: `rigel forward lab-arm PORT`"


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


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "error forwarding port 9090 to pod 3f, uid : failed to connect to localhost:9090 inside"
            ' namespace "3f", IPv4: dial tcp4 127.0.0.1:9090: connect: connection refused',
            "nothing listens on port 9090 in talker",
        ),
        ("error forwarding port 9090: lost connection to pod", None),
    ],
)
def test_a_port_without_a_server_is_named(text: str, told: str | None) -> None:
    """The container runtime's own words are 300 characters; others are passed on."""
    assert explain_forward(text, "talker") == (told or text)

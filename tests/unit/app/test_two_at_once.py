"""An update runs two pods of a node at once only where one machine can run both."""

from __future__ import annotations

import pytest

from .shapes import find, problems, release

HOST, PEERS = "network: host", "network: peers"
GPU = "resources: {limits: {nvidia.com/gpu: 1}}"
PATCH = "patch: {spec: {template: {spec: {containers: [{name: ros-node, %s}]}}}}"
CLAIM = "persistent_storage: {volumes: [{name: v, access_mode: %s}]}"
#: A job, a node, and why one machine cannot run two of it; "" if it can.
ONE = [
    ("", GPU, "it has the device nvidia.com/gpu"),
    ("", "resources: {requests: {nvidia.com/gpu: 2}}", "it has the device nvidia.com/gpu"),
    ("", "devices: [{resource: nvidia.com/gpu}]", "it has the device nvidia.com/gpu"),
    ("", PATCH % GPU, "it has the device nvidia.com/gpu"),
    ("", "resources: {limits: {nvidia.com/gpu: 0}}", ""),
    ("", "resources: {limits: {cpu: 1, memory: 1Gi}}", ""),
    (HOST, "ports: [8080]", "it has a port of its machine"),
    ("", "ports: [8080], host_network: true", "it has a port of its machine"),
    ("", "ports: [8080]", ""),
    (HOST, "env: {A: b}", ""),
    ("", PATCH % "ports: [{containerPort: 1, hostPort: 1}]", "it has a port of its machine"),
    (HOST, PATCH % "ports: [{containerPort: 1}]", "it has a port of its machine"),
    (CLAIM % "ReadWriteOncePod", "volumes: [v]", "its volume v is ReadWriteOncePod"),
    (CLAIM % "ReadWriteMany", "volumes: [v]", ""),
]


def make(job: str, node: str) -> str:
    """Return a job's `with`."""
    return f"{{image: a, {job}{',' * bool(job)} nodes: {{n: {{args: x, {node}}}}}}}"


@pytest.mark.parametrize(("job", "node", "reason"), ONE)
@pytest.mark.parametrize(("distro", "anonymous"), [("noetic", 0), ("jazzy", 0), ("jazzy", 1)])
def test_the_old_pod_leaves_first_where_two_cannot_run(
    distro: str, anonymous: int, job: str, node: str, reason: str
) -> None:
    """In both generations, in whichever form, and for nodes whose name differs in each pod."""
    text = make(job, node + ", anonymous: true" * anonymous)
    made = find(release(text, distro=distro), "Deployment", "n")
    assert made["spec"]["strategy"]["type"] == ("Recreate" if reason else "RollingUpdate")
    note = made["metadata"]["annotations"]["rigel-k8s/update"]
    if reason:
        assert note == f"Recreate: {reason}"
    assert not [p for p in problems(text, distro) if p.kind == "two-at-once"]


@pytest.mark.parametrize(("job", "node", "reason"), [one for one in ONE if one[2]])
def test_a_hand_over_of_such_a_node_is_refused(job: str, node: str, reason: str) -> None:
    found = problems(make(job, f"{node}, update: {{strategy: HandOver}}"), "jazzy")
    messages = [p.message for p in found if p.kind == "hand-over"]
    assert messages == [f"HandOver is not possible: {reason}"]


def test_who_asks_for_both_gets_both() -> None:
    """Other machines may have another GPU."""
    text = make("", f"{GPU}, anonymous: true, update: {{strategy: Rolling}}")
    made = find(release(text, distro="jazzy"), "Deployment", "n")
    assert made["spec"]["strategy"]["type"] == "RollingUpdate"
    assert not [p for p in problems(text, "jazzy") if p.kind == "two-at-once"]

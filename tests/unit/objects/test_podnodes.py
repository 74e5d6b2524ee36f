"""A pod with several nodes is read as one of each: its names, its container, its readiness."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_graph.pods import expected_nodes, mark_shared, read_pods
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_graph.watching import name_nodes
from rigel_k8s.commands.pods import find_matching, pod_of
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.podnodes import note_nodes, split
from rigel_k8s.release.rollout.causes import find_turn, probe_failure
from rigel_k8s.release.rollout.view import find_related
from rigel_k8s.release.status import describe_nodes

NAMES = {"camera": "/camera", "ns-detector": "/ns/detector"}
NOTES = note_nodes(
    {
        container: {"rigel-k8s/node": name, "rigel-k8s/ros-name": name}
        for container, name in NAMES.items()
    }
)
WAITS = "Startup probe failed: waits to take over from perception-0 [waits]"


def make_pod(name: str = "perception-1", *, ready: bool = False) -> dict[str, Any]:
    """Return the pod; its second container is ready only if it is."""
    states = [
        {"name": "camera", "ready": True, "restartCount": 0, "state": {"running": {}}},
        {"name": "ns-detector", "ready": ready, "restartCount": 3, "state": {"running": {}}},
    ]
    condition = {"status": "True"} if ready else {"status": "False", "reason": "ContainersNotReady"}
    mount = {"name": "rigel-inpod", "mountPath": "/rigel-k8s"}
    note = '{"mode": "peers", "ros": "2", "shared_memory": true}'
    return {
        "kind": "Pod",
        "metadata": {
            "name": name,
            "namespace": "robots",
            "uid": name,
            "labels": {"app.kubernetes.io/name": "perception", "team": "x"},
            "annotations": {**NOTES, "rigel-k8s/network": note},
            "ownerReferences": [{"controller": True, "uid": "set"}],
        },
        "spec": {
            "nodeName": "node1",
            "containers": [{"name": one, "image": one, "volumeMounts": [mount]} for one in NAMES],
        },
        "status": {
            "phase": "Running",
            "containerStatuses": states,
            "conditions": [{"type": "Ready", **condition}],
        },
    }


def make_deployment() -> dict[str, Any]:
    """Return its Deployment."""
    template = {"metadata": {"annotations": NOTES}, "spec": make_pod()["spec"]}
    return {
        "kind": "Deployment",
        "metadata": {"name": "perception", "namespace": "robots", "uid": "w", "annotations": NOTES},
        "spec": {"replicas": 1, "template": template},
        "status": {},
    }


def test_each_node_has_its_container_and_names() -> None:
    """What is of the pod stays the same in each."""
    parts = list(split(make_pod()))
    assert [part["spec"]["containers"][0]["image"] for part in parts] == list(NAMES)
    for part, (container, name) in zip(parts, NAMES.items(), strict=True):
        assert part["metadata"]["labels"] == {"app.kubernetes.io/name": container, "team": "x"}
        assert part["metadata"]["annotations"]["rigel-k8s/ros-name"] == name
        assert part["metadata"]["name"] == "perception-1"


def test_a_node_is_ready_without_the_others() -> None:
    """Its pod is not; but a pod that is not ready for another reason has no node that is."""
    assert [is_ready(part) for part in split(make_pod())] == [True, False]
    lost = make_pod(ready=True)
    lost["status"]["conditions"] = [{"type": "Ready", "status": "False"}]
    assert [is_ready(part) for part in split(lost)] == [False, False]


def test_other_objects_stay_as_they_are() -> None:
    """Nearly all pods have one node, and what has a malformed note is read as one."""
    plain = {"kind": "Pod", "metadata": {"name": "a"}, "spec": {"containers": []}}
    assert list(split(plain)) == [plain]
    odd = {"metadata": {"annotations": {"rigel-k8s/nodes": "{"}}}
    assert list(split(odd)) == [odd]


def test_nodes_are_found_by_all_their_names() -> None:
    """By the pod's name all of its nodes are."""
    pods = [pod_of(part) for part in split(make_pod())]
    for name in ("camera", "/camera"):
        assert [pod.container for pod in find_matching(pods, name)] == ["camera"]
    for name in ("/ns/detector", "ns/detector", "ns-detector"):
        (found,) = find_matching(pods, name)
        assert (found.container, found.workload, found.restarts) == ("ns-detector",) * 2 + (3,)
    for name in ("perception", "perception-1"):
        assert find_matching(pods, name) == pods


def test_a_deployment_promises_all_its_nodes() -> None:
    """The graph expects each, in a workload of the node's name."""
    assert name_nodes(make_deployment()) == list(NAMES.values())
    assert expected_nodes([make_deployment()]) == {name: one for one, name in NAMES.items()}


def test_status_has_a_row_for_each_node() -> None:
    """Whose pods are ready is counted for the node."""
    found = list(describe_nodes(make_deployment(), find_related([], [])))
    assert [one.name for one in found] == list(NAMES)
    related = find_related(
        [
            {
                "kind": "ReplicaSet",
                "metadata": {"uid": "set", "ownerReferences": [{"controller": True, "uid": "w"}]},
            }
        ],
        [make_pod()],
    )
    found = list(describe_nodes(make_deployment(), related))
    assert [[pod.ready for pod in one.pods] for one in found] == [[True], [False]]
    assert [one.annotations["rigel-k8s/ros-name"] for one in found] == list(NAMES.values())


@pytest.mark.parametrize(
    ("texts", "failure", "turn"),
    [
        ([WAITS, WAITS], f"camera: {WAITS}", "waits to take over from perception-0"),
        ([WAITS, "no node yet"], "ns-detector: no node yet", ""),
        (["no node yet", WAITS], "camera: no node yet", ""),
    ],
)
def test_a_pod_waits_only_if_all_its_nodes_do(texts: list[str], failure: str, turn: str) -> None:
    """What is wrong with one of them is not hidden by another one that waits for it."""
    pod = make_pod()
    pod["status"]["containerStatuses"][0]["ready"] = False
    events = [
        {
            "reason": "Unhealthy",
            "message": text,
            "lastTimestamp": f"2026-01-01T00:00:0{index}Z",
            "involvedObject": {"uid": "perception-1", "fieldPath": f"spec.containers{{{name}}}"},
        }
        for index, (name, text) in enumerate(zip(NAMES, texts, strict=True))
    ]
    assert probe_failure(pod, events) == failure
    assert find_turn(pod, events) == turn
    assert [probe_failure(part, events) for part in split(pod)] == texts


def test_messages_within_a_pod_go_by_shared_memory() -> None:
    """Those to another pod do not, even if that shares memory within itself."""
    pods = read_pods([make_pod(), make_pod("perception-2")])
    nodes = [
        GraphNode("/camera", pod="perception-1", workload="camera"),
        GraphNode("/ns/detector", pod="perception-1", workload="ns-detector"),
        GraphNode("/other", pod="perception-2", workload="camera"),
        GraphNode("/laptop"),
    ]
    names = tuple(node.name for node in nodes)
    topic = GraphTopic("/image", publishers=("/camera", "/laptop"), subscribers=names)
    (found,) = mark_shared(RosGraph(topics=(topic,)), nodes, pods)
    assert found.shared == (("/camera", "/ns/detector"),)

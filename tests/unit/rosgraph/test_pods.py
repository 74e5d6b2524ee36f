"""Which pod a node is in, which nodes a release expects, and what is wrong."""

from __future__ import annotations

import json
from typing import Any

import attrs
import pytest

from rigel_graph.pods import GraphPod, expected_nodes, find_leaving, place_nodes, read_pods
from rigel_graph.problems import find_problems
from rigel_graph.types import GraphNode, GraphTopic, Mismatch, RosGraph
from rigel_k8s.objects.marks import FIELD_MANAGER
from rigel_k8s.ros import ROS_2

TALKER = GraphPod(
    "talker-1",
    "robots",
    "talker",
    "c",
    "node1",
    "/talker",
    addresses=frozenset({"10.0.0.1"}),
    ready=True,
)
LAUNCH = GraphPod(
    "nav-1", "robots", "nav", "c", "node2", addresses=frozenset({"10.0.0.2", "10.1.0.2"})
)


def pod(name: str, **meta: Any) -> dict[str, Any]:
    networks = [{"interface": "net1", "ips": ["10.1.0.9"]}]
    notes = {
        "rigel-k8s/ros-name": f"/{name}",
        "rigel-k8s/network": json.dumps({"mode": "macvlan", "ros": "2"}),
        "k8s.v1.cni.cncf.io/network-status": json.dumps(networks),
    }
    mount = {"name": "inpod", "mountPath": "/rigel-k8s"}
    return {
        "metadata": {
            "name": f"{name}-1",
            "namespace": "robots",
            "labels": {"app.kubernetes.io/name": name},
            "annotations": notes,
            **meta,
        },
        "spec": {
            "nodeName": "node1",
            "containers": [{"name": "sidecar"}, {"name": "ros-node", "volumeMounts": [mount]}],
        },
        "status": {
            "podIP": "10.0.0.9",
            "podIPs": [{"ip": "10.0.0.9"}],
            "conditions": [{"type": "Ready", "status": "True"}],
            "containerStatuses": [{"name": "ros-node", "state": {"running": {}}}],
        },
    }


def test_nodes_of_pods_that_are_terminated_are_leaving() -> None:
    """Also where a node of another pod has their name and address already."""
    old = pod("old", deletionTimestamp="2026-01-01T00:00:00Z")
    assert find_leaving([old]) == ("/old",)
    assert find_leaving([old, pod("new")]) == ("/old",)
    assert find_leaving([pod("new")]) == ()


def test_pods_are_read_from_what_kubernetes_says() -> None:
    """One that is ending, or has run once, is left out: its node leaves the graph."""
    done = pod("c")
    done["status"]["phase"] = "Succeeded"
    assert read_pods([pod("b"), pod("a", deletionTimestamp="2026-01-01T00:00:00Z"), done]) == (
        GraphPod(
            name="b-1",
            namespace="robots",
            workload="b",
            container="ros-node",
            machine="node1",
            ros_name="/b",
            ros=ROS_2,
            addresses=frozenset({"10.0.0.9", "10.1.0.9"}),
            ready=True,
            running=True,
        ),
    )


def deployment(name: str, replicas: int = 1, **notes: str) -> dict[str, Any]:
    return {
        "metadata": {"name": name, "annotations": {"rigel-k8s/ros-name": f"/{name}"}},
        "spec": {"replicas": replicas, "template": {"metadata": {"annotations": notes}}},
    }


def test_deployments_with_pods_and_ros_promise_nodes() -> None:
    none = {"rigel-k8s/ros": "none"}
    dds = {"rigel-k8s/network": '{"ros": "none"}'}
    found = [deployment("a"), deployment("b", 0), deployment("c", **none), deployment("d", **dds)]
    assert expected_nodes(found) == {"/a": "a"}


def test_the_pods_of_a_launch_file_promise_a_node_where_none_is_seen() -> None:
    """Their Deployment has no ROS name, as the launch file gives its nodes theirs."""
    launch = deployment("bringup", **{"rigel-k8s/ros-name": "/bringup"})
    del launch["metadata"]["annotations"]
    assert expected_nodes([launch]) == {"/bringup": "bringup"}


def test_what_someone_has_scaled_to_0_is_still_expected() -> None:
    """Its node is missing, as `rigel status` says."""
    stopped = {**deployment("b", 0), "kind": "Deployment"}
    ours = {"manager": FIELD_MANAGER, "operation": "Apply", "fieldsV1": {"f:spec": {"f:x": {}}}}
    stopped["metadata"]["managedFields"] = [ours]
    assert expected_nodes([stopped]) == {"/b": "b"}
    graph = RosGraph(place_nodes([], [], expected_nodes([stopped])))
    [problem] = find_problems(graph)
    assert problem.message == "/b is not in the graph: it has no pod"


def placed(node: GraphNode, *pods: GraphPod) -> tuple[str, str]:
    (found,) = place_nodes([node], pods, {})
    return found.pod, found.machine


def test_a_node_is_in_the_pod_of_its_name_or_of_its_address() -> None:
    twin = attrs.evolve(TALKER, name="talker-2", machine="node3", addresses=frozenset({"10.0.0.3"}))
    assert placed(GraphNode("/talker", address="10.9.9.9"), TALKER, LAUNCH) == ("talker-1", "node1")
    assert placed(GraphNode("/amcl", address="10.1.0.2"), TALKER, LAUNCH) == ("nav-1", "node2")
    assert placed(GraphNode("/talker", address="10.0.0.3"), TALKER, twin) == ("talker-2", "node3")
    assert placed(GraphNode("/rviz", address="10.9.9.9"), TALKER, LAUNCH) == ("", "")


def test_pods_that_share_their_machines_address_share_its_name() -> None:
    """As with the machines' own network."""
    host = attrs.evolve(LAUNCH, name="other-1", machine="node2")
    assert placed(GraphNode("/amcl", address="10.0.0.2"), LAUNCH, host) == ("", "node2")


def test_an_expected_node_that_is_not_there_is_in_the_graph_as_missing() -> None:
    """Unless its pod's program has given itself another name."""
    amcl = GraphNode("/amcl", address="10.0.0.2")
    found = place_nodes([amcl], [TALKER, LAUNCH], {"/talker": "talker", "/nav": "nav", "/c": "c"})
    assert [(node.name, node.registered, node.pod) for node in found] == [
        ("/amcl", True, "nav-1"),
        ("/c", False, ""),
        ("/talker", False, "talker-1"),
    ]


def messages(graph: RosGraph) -> list[tuple[str, str, bool]]:
    return [(one.kind, one.message, one.is_error) for one in find_problems(graph)]


def test_a_nodes_nearest_cause_is_named() -> None:
    nodes = (
        GraphNode("/a", pod="a-1", registered=False, up=False, ready=False),
        GraphNode("/b", registered=False, up=False),
        GraphNode("/c", pod="c-1", registered=False, up=False),
        GraphNode("/d", up=False),
        GraphNode("/e", pod="e-1", ready=False),
        GraphNode("/f"),
    )
    assert messages(RosGraph(nodes)) == [
        ("missing", "/a is not in the graph: its pod a-1 is not ready", True),
        ("missing", "/b is not in the graph: it has no pod", True),
        (
            "missing",
            "/c is not in the graph: its pod c-1 is ready; check whether its program uses another"
            " name",
            True,
        ),
        ("no-answer", "/d does not answer", True),
        ("not-ready", "/e: its pod e-1 is not ready", True),
    ]


def test_topics_without_publishers_and_types_that_differ_are_named() -> None:
    """A topic that nobody subscribes to is in order, and so is /clock without a publisher."""
    topics = (
        GraphTopic("/clock", subscribers=("/a",)),
        GraphTopic("/goal", subscribers=("/a", "/b", "/c", "/d")),
        GraphTopic("/lonely", publishers=("/a",)),
        GraphTopic("/scan", "S", ("/a",), ("/b",), (Mismatch("/b", "T"),)),
    )
    assert messages(RosGraph((), topics)) == [
        ("type", "/b uses /scan as T, the others as S", True),
        ("no-publisher", "/goal has no publisher; subscribed by /a, /b, /c, ...", False),
    ]


@pytest.mark.parametrize(("kind", "meant"), [("S", True), ("T", False), ("", True)])
def test_a_similar_topic_of_the_same_type_is_probably_meant(kind: str, meant: bool) -> None:  # noqa: FBT001
    """ROS 1 does not know the type of a topic without a publisher."""
    topics = (GraphTopic("/scan", "S", ("/a",)), GraphTopic("/scna", kind, subscribers=("/b",)))
    (problem,) = find_problems(RosGraph((), topics))
    assert problem.remedy == ("is /scan meant, which is published?" if meant else "")


def test_graphs_are_equal_whatever_differs_after_each_restart() -> None:
    """Machines, pods, addresses and rates do not count; nodes and their ends do."""
    one = RosGraph(
        (GraphNode("/a", "node1", "a-1", "a", "10.0.0.1"),), (GraphTopic("/t", rate=1.0),)
    )
    other = RosGraph((GraphNode("/a", "node2", "a-2", "a", "10.0.0.2"),), (GraphTopic("/t"),))
    assert one == other
    assert one != attrs.evolve(one, topics=(GraphTopic("/t", publishers=("/a",)),))

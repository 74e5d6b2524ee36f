"""ROS 2's graph comes from what the nodes' own processes have noted."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_graph import dds, ros2
from rigel_graph.discovery.inside import Unread
from rigel_graph.discovery.members import members
from rigel_graph.pods import GraphPod, read_pod
from rigel_graph.problems import find_problems
from rigel_graph.types import GraphNode, GraphService, GraphTopic, Mismatch, RosGraph
from rigel_k8s.errors import ClusterError
from tests.support.members import pod
from tests.support.notes import (
    NOW,
    SECOND,
    STRING,
    Answer,
    answer,
    entity,
    process,
    publisher,
    subscription,
)

from .local import POD, LocalCluster

PODS = {
    name: GraphPod(
        f"{name}-1", "robots", name, "c", "machine", ready=True, running=True, has_layer=True
    )
    for name in ("talker", "listener")
}


def twice(first: Answer, second: Answer | None = None) -> ros2.Answer:
    """What a pod prints: by default, the same after two seconds."""
    return {"first": {**first, "now": NOW - 2 * SECOND}, "second": second or first}


def parse(**pods: ros2.Answer) -> RosGraph:
    """The graph of some pods, by their workloads."""
    found = {PODS[name].name: answer for name, answer in pods.items()}
    return ros2.parse(found, {pod.name: pod for pod in PODS.values()})


def talker(count: int = 0, **fields: Any) -> Answer:
    """A talker's pod."""
    parts = [publisher("/talker", "/chatter", count, **{"matched": 1, **fields})]
    return answer(process("/talker", parts=parts))


def listener(count: int = 0, **fields: Any) -> Answer:
    """A listener's pod, with a service."""
    kind = "std_srvs/srv/Empty"
    parts = [
        subscription("/listener", "/chatter", count, **{"matched": 1, **fields}),
        entity("service", "/listener/reset", "/listener", type=kind),
        entity("client", "/other/reset", "/listener", type=kind),
    ]
    return answer(process("/listener", parts=parts))


def test_nodes_are_in_the_pods_that_noted_them() -> None:
    """Several pods of a machine's network have one address, but never one file."""
    graph = parse(talker=twice(talker(10), talker(50)), listener=twice(listener(10), listener(50)))
    assert [(node.name, node.pod, node.machine) for node in graph.nodes] == [
        ("/listener", "listener-1", "machine"),
        ("/talker", "talker-1", "machine"),
    ]
    assert graph.topics == (GraphTopic("/chatter", STRING, ("/talker",), ("/listener",)),)
    assert graph.topics[0].rate == 20.0
    service = GraphService("/listener/reset", "std_srvs/srv/Empty", ("/listener",))
    assert graph.services == (service,)
    assert find_problems(graph) == ()


def test_a_topic_from_elsewhere_has_the_rate_that_is_heard() -> None:
    graph = parse(listener=twice(listener(10), listener(30)))
    assert graph.topics[0].rate == 10.0


def test_a_topic_that_loses_messages_is_named() -> None:
    """From the counts at both ends, although they are in two pods."""
    graph = parse(talker=twice(talker(10), talker(70)), listener=twice(listener(10), listener(12)))
    (problem,) = find_problems(graph)
    assert problem.message == "/chatter: 30.0/s sent by talker, 1.0/s taken by listener"


def test_a_type_that_differs_is_named() -> None:
    graph = parse(talker=twice(talker()), listener=twice(listener(type="std_msgs/msg/Int8")))
    assert graph.topics[0].mismatches == (Mismatch("/listener", "std_msgs/msg/Int8"),)
    assert graph.topics[0].alone == ()


def test_an_endpoint_that_has_found_no_partner_is_named() -> None:
    """For example one that is reliable, and others that are not; it has some time to find one."""
    graph = parse(talker=twice(talker()), listener=twice(listener(matched=0)))
    (problem,) = find_problems(graph)
    assert (problem.kind, problem.severity) == ("unmatched", "warning")
    assert "/listener has no partner on /chatter" in problem.message
    young = parse(talker=twice(talker()), listener=twice(listener(matched=0, created=NOW)))
    assert find_problems(young) == ()


def test_an_executor_that_stands_still_is_named() -> None:
    """The node of it still answers discovery, so nothing else would show it."""
    stuck = answer(process("/planner", stands=41 * SECOND))
    (problem,) = find_problems(parse(talker=twice(stuck)))
    assert problem.message == "/planner: no turn of its executor for 41 s"
    assert not find_problems(parse(talker=twice(answer(process("/planner", stands=SECOND)))))


class Cluster:
    """Pods that print answers, by their names."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, **answers: Any) -> None:
        def read(_: object, pod: GraphPod, span: float) -> Any:
            found = answers[pod.workload]
            if isinstance(found, Exception):
                raise found
            return found

        monkeypatch.setattr(ros2, "read_notes", read)

    def parallel(self, function: Any, items: Any) -> Any:
        return [function(item) for item in items]


def test_a_node_that_is_only_discovered_is_read_from_dds(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nodes with notes are not asked a second time: what they note is exact."""
    heard = RosGraph(
        nodes=(GraphNode("/rviz", address="10.0.0.7"), GraphNode("/talker", up=False)),
        topics=(
            GraphTopic("/chatter", STRING, ("/talker",), ("/rviz",)),
            GraphTopic("/goal", "T", ("/rviz",)),
            GraphTopic("/old", "T", ("/talker",)),
        ),
        services=(GraphService("/rviz/reset", "T", ("/rviz",)),),
    )
    monkeypatch.setattr(dds, "read", lambda *_: heard)
    noted = answer(process("/talker", parts=[publisher("/talker", "/chatter")], seen=["/rviz"]))
    cluster: Any = Cluster(monkeypatch, talker=twice(noted))
    graph = ros2.read(cluster, [PODS["talker"]], members([pod()]))
    assert [(node.name, node.up, node.pod) for node in graph.nodes] == [
        ("/rviz", True, ""),
        ("/talker", True, "talker-1"),
    ]
    assert {one.name: (one.publishers, one.subscribers) for one in graph.topics} == {
        "/chatter": (("/talker",), ("/rviz",)),
        "/goal": (("/rviz",), ()),
    }
    assert [service.name for service in graph.services] == ["/rviz/reset"]


def test_zenoh_is_read_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of nodes outside of the release the names are known, which processes have discovered."""
    noted = answer(process("/talker", seen=["/talker", "/far"]))
    (member,) = members([pod()])
    zenoh = attrs.evolve(member, middleware="zenoh")
    cluster: Any = Cluster(monkeypatch, talker=twice(noted))
    graph = ros2.read(cluster, [PODS["talker"]], [zenoh])
    assert [node.name for node in graph.nodes] == ["/far", "/talker"]


def test_without_a_layer_dds_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pod that an older version deployed, or one with `rmw_layer: false`."""
    monkeypatch.setattr(dds, "read", lambda *_: RosGraph((GraphNode("/heard"),)))
    cluster: Any = Cluster(monkeypatch)
    bare = attrs.evolve(PODS["talker"], has_layer=False)
    assert ros2.read(cluster, [bare], members([pod()])).nodes == (GraphNode("/heard"),)


def test_a_pod_that_cannot_be_read_hides_only_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """If none can be read, the reason is reported."""
    failure = Unread("listener-1", "no python3")
    cluster: Any = Cluster(monkeypatch, talker=twice(talker()), listener=failure)
    found = ros2.read(cluster, list(PODS.values()), members([pod()]))
    assert [node.name for node in found.nodes] == ["/talker"]
    with pytest.raises(ClusterError, match="no python3"):
        ros2.read(cluster, [PODS["listener"]], members([pod()]))


def test_a_pod_shows_that_it_has_the_layer() -> None:
    item = pod()
    assert not read_pod(item).has_layer
    for container in item["spec"]["containers"]:
        container["env"] = [{"name": "RIGEL_RMW", "value": "/run/x"}]
    assert read_pod(item).has_layer


@pytest.mark.programs
def test_the_program_is_sent_and_prints_notes(tmp_path: Path) -> None:
    """It needs no file of ours in the pod; one without a directory of notes says so."""
    cluster: Any = LocalCluster(RIGEL_RMW=str(tmp_path))
    found = ros2.ask(cluster, POD)
    assert not isinstance(found, ClusterError)
    assert found["first"]["processes"] == found["second"]["processes"] == []
    assert found["second"]["now"] - found["first"]["now"] >= ros2.SPAN * SECOND
    failure = ros2.ask(LocalCluster(**os.environ), POD)  # type: ignore[arg-type]
    assert "no notes of ROS 2 processes" in str(failure)

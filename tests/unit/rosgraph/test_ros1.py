"""What is read of ROS 1 by programs that are run in a pod, here against a graph of threads."""

from __future__ import annotations

import json
import os
import socketserver
import sys
import threading
import xmlrpc.server
from collections.abc import Iterator
from typing import Any

import pytest

from rigel_graph import ros1
from rigel_graph.discovery import inside
from rigel_graph.pods import GraphPod
from rigel_graph.types import (
    GateStatus,
    GraphNode,
    GraphTopic,
    Mismatch,
    NameConflict,
    WaitingNode,
)
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.network.wiring import NETWORK_ANNOTATION
from rigel_k8s.objects import pods
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.types import ReleaseId
from tests.support.pythons import find_python
from tests.support.rosgraph import ros_graph

from .local import POD, LocalCluster

pytestmark = pytest.mark.programs

RELEASE = ReleaseId("robots", "explorer")
MODULES = [
    ("rosrpc", inside.read_module("rigel_inpod.rosrpc")),
    ("ros1_graph", inside.read_module("rigel_inpod.sent.ros1_graph")),
]


def run(python: str, uri: str, *, answer: float = 3.0) -> Any:
    """Run the program here; a node has so many seconds to answer."""
    modules = [(name, text.replace("ANSWER = 3.0", f"ANSWER = {answer}")) for name, text in MODULES]
    cluster: Any = LocalCluster(ROS_MASTER_URI=uri)
    return inside.run_inside(cluster, POD, modules, pythons=["no-python3", python])


@pytest.fixture(params=["2.7", "3.6", "3"])
def python(request: pytest.FixtureRequest) -> str:
    return sys.executable if request.param == "3" else find_python(request.param)


def test_a_graph_is_read_as_the_master_and_the_nodes_tell_it(python: str) -> None:
    """Who publishes, who subscribes, where a node is, and that nothing registers."""
    with ros_graph() as graph:
        graph.node("/talker", ["/chatter"])
        graph.node("/listener", subscribes=["/chatter"])
        graph.master.types["/chatter"] = "std_msgs/String"
        graph.master.services["/talker/set_level"] = ["/talker"]
        found = ros1.parse(run(python, graph.master.uri))
        assert graph.master.calls == []
    assert found.nodes == (GraphNode("/listener"), GraphNode("/talker"))
    assert {node.address for node in found.nodes} == {"127.0.0.1"}
    assert found.topics == (
        GraphTopic("/chatter", "std_msgs/String", ("/talker",), ("/listener",)),
    )
    assert [(one.name, one.providers) for one in found.services] == [
        ("/talker/set_level", ("/talker",))
    ]


def test_a_node_that_hangs_costs_no_other_its_answer() -> None:
    """It is in the graph and not up; a node that has gone without leave is the same."""
    with ros_graph() as graph:
        graph.node("/talker", ["/chatter"])
        graph.master.add("/hangs", graph.serve_silence(), ["/scan"])
        graph.master.add("/gone", "http://127.0.0.1:1/", [], ["/scan"])
        found = ros1.parse(run(sys.executable, graph.master.uri, answer=0.5))
    assert {node.name: node.up for node in found.nodes} == {
        "/gone": False,
        "/hangs": False,
        "/talker": True,
    }


def test_a_master_that_does_not_answer_is_named() -> None:
    with pytest.raises(ClusterError, match=r"ROS master at .* does not answer"):
        run(sys.executable, "http://127.0.0.1:1/")


def test_a_pod_without_python_is_named() -> None:
    cluster: Any = LocalCluster()
    with pytest.raises(ClusterError, match="its image has no no-python"):
        inside.run_inside(cluster, POD, MODULES, pythons=["no-python3", "no-python"])
    with pytest.raises(ClusterError, match="its image has no python3"):
        inside.run_inside(cluster, POD, MODULES, pythons=["no-python3"])


ANSWER: dict[str, Any] = {
    "publishers": {"/scan": ["/lidar"], "/rosout": ["/lidar", "/ros_exporter"]},
    "subscribers": {"/scan": ["/mapper", "/ros_exporter"], "/tick": ["/ros_exporter"]},
    "services": {"/ros_exporter/x": ["/ros_exporter"]},
    "types": {"/scan": "sensor_msgs/LaserScan"},
    "nodes": [
        {
            "name": "/lidar",
            "uri": "http://10.0.0.1:1/",
            "address": "10.0.0.1",
            "pid": "7",
            "publications": [["/scan", "sensor_msgs/LaserScan"]],
            "subscriptions": [],
            "seconds": 2.0,
            # rospy's and, behind it, roscpp's form of a connection.
            "stats": [
                [[["/scan", "500", [["1", "500", "10", "1"]]]], [], []],
                [[["/scan", "900", [["1", "900", "30", "1"]]]], [], []],
            ],
        },
        {
            "name": "/mapper",
            "uri": "http://10.0.0.2:1/",
            "address": "10.0.0.2",
            "pid": "8",
            "publications": [],
            "subscriptions": [["/scan", "sensor_msgs/PointCloud2"]],
        },
        {"name": "/ros_exporter", "uri": "", "address": ""},
    ],
}


def test_exporters_are_no_part_of_the_graph() -> None:
    found = ros1.parse(ANSWER)
    assert [node.name for node in found.nodes] == ["/lidar", "/mapper"]
    assert [topic.name for topic in found.topics] == ["/rosout", "/scan"]
    assert found.services == ()


def test_rates_are_what_publishers_counted_between_two_answers() -> None:
    rates = {topic.name: topic.rate for topic in ros1.parse(ANSWER).topics}
    assert rates == {"/rosout": None, "/scan": 10.0}


def test_a_node_with_another_type_is_named() -> None:
    """Two nodes of one topic that name different types never exchange a message."""
    (scan,) = (topic for topic in ros1.parse(ANSWER).topics if topic.name == "/scan")
    assert scan.type == "sensor_msgs/LaserScan"
    assert scan.mismatches == (Mismatch("/mapper", "sensor_msgs/PointCloud2"),)


def test_the_masters_pod_is_asked_and_no_other_in_its_place() -> None:
    """Without a master of its own, a release asks from a node's pod that is ready."""
    talker = GraphPod("talker-1", "robots", "talker", "c", running=True, ready=True)
    late = GraphPod("late-1", "robots", "late", "c", running=True)
    exporter = GraphPod("ros-exporter-1", "robots", "ros-exporter", "c", running=True, ready=True)
    assert ros1.choose_pod([exporter, late, talker, POD]) == POD
    assert ros1.choose_pod([exporter, late, talker]) == talker
    ended = GraphPod("ros-master-1", "robots", "ros-master", "c")
    with pytest.raises(ClusterError, match="roscore does not run"):
        ros1.choose_pod([ended, talker])


class OnePod(LocalCluster):
    """A cluster with one pod, which is this machine."""

    ros = "1"

    def list(self, *_: Any, **__: Any) -> list[dict[str, Any]]:
        meta: dict[str, Any] = {
            "name": "here",
            "namespace": "robots",
            "labels": {RELEASE_LABEL: "explorer"},
        }
        meta["annotations"] = {NETWORK_ANNOTATION: json.dumps({"ros": self.ros})}
        container = {"name": "ros-node"}
        state = {"name": "ros-node", "state": {"running": {}}}
        status = {"phase": "Running", "containerStatuses": [state]}
        return [{"metadata": meta, "spec": {"containers": [container]}, "status": status}]


@pytest.mark.parametrize("python", ["2.7", "3"])
def test_parameters_have_the_types_that_the_master_has(
    python: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = sys.executable if python == "3" else find_python(python)
    monkeypatch.setattr("rigel_graph.ros1.PYTHONS", ["no-python3", found])
    with ros_graph() as graph:
        values = {"/rate": 2.5, "/a/list": [1, "x", True], "/tree": {"k": "ü"}, "/run_id": "run-1"}
        graph.master.parameters = values  # type: ignore[assignment]
        cluster: Any = OnePod(ROS_MASTER_URI=graph.master.uri)
        assert ros1.list_parameters(cluster, RELEASE) == sorted(values)
        for name, value in values.items():
            assert ros1.read_parameter(cluster, RELEASE, name) == (value,)
        assert ros1.read_parameter(cluster, RELEASE, "/missing") == ()


def test_a_master_that_does_not_answer_is_an_error() -> None:
    cluster: Any = OnePod(ROS_MASTER_URI="http://127.0.0.1:9/")
    with pytest.raises(ClusterError, match="does not answer"):
        ros1.list_parameters(cluster, RELEASE)


def test_ros_2_has_no_master() -> None:
    cluster: Any = OnePod()
    cluster.ros = "2"
    with pytest.raises(UserError, match="no ROS master"):
        ros1.list_parameters(cluster, RELEASE)


GATE = {
    "waiting": [{"node": "/talker", "api": "http://10.0.0.2:1/", "owner": "http://10.0.0.1:1/"}],
    "conflicts": [
        {"node": "/map", "old": "http://10.0.0.3:1/", "new": "http://10.0.0.4:1/", "time": 3.5}
    ],
    "silent": ["/camera"],
    "has_master": False,
    "restarts": 2,
    "nodes": 7,
    "blocked": "the new master cannot be given its registrations",
    "refused": ["service /ask of /talker at http://10.0.0.2:1/: bug"],
    "unkept": ["the memory is not kept in the cluster: away"],
    "notes": ["12 connections were refused"],
}


class MasterCluster(LocalCluster):
    """A cluster with a ros-master pod that is this machine."""

    def __init__(self, *containers: str, state: str = "running") -> None:
        super().__init__(PATH=os.environ["PATH"])
        self.containers, self.state = containers, state

    def list(self, api_version: str, kind: str, namespace: str, *, labels: Any) -> list[Any]:
        assert labels == {"rigel-k8s/release": "explorer", "app.kubernetes.io/name": "ros-master"}
        states = [{"name": name, "state": {self.state: {}}} for name in self.containers]
        return [
            {
                "metadata": {"name": "ros-master-1"},
                "spec": {"containers": [{"name": name} for name in self.containers]},
                "status": {"containerStatuses": states},
            }
        ]


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A server that describes itself as a gate does."""
    server = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
    server.register_function(lambda _: [1, "", json.dumps(GATE)], "rigelDescribeGate")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    ask = ros1.ASK.replace(str(pods.MASTER_PORT), str(server.server_address[1]))
    monkeypatch.setattr(ros1, "ASK", ask)
    yield
    server.shutdown()
    server.server_close()


@pytest.mark.usefixtures("answering")
def test_a_gate_is_asked_in_its_pod() -> None:
    """What it answers, as values."""
    cluster = MasterCluster("ros-master", "gate")
    assert ros1.read_gate(cluster, RELEASE) == GateStatus(  # type: ignore[arg-type]
        waiting=(WaitingNode("/talker", "http://10.0.0.2:1/", "http://10.0.0.1:1/"),),
        conflicts=(NameConflict("/map", "http://10.0.0.3:1/", "http://10.0.0.4:1/", 3.5),),
        silent=("/camera",),
        has_master=False,
        restarts=2,
        blocked="the new master cannot be given its registrations",
        refused=("service /ask of /talker at http://10.0.0.2:1/: bug",),
        unkept=("the memory is not kept in the cluster: away",),
        notes=("12 connections were refused",),
    )
    assert cluster.pods == ["ros-master-1"]


@pytest.mark.usefixtures("answering")
def test_an_earlier_gate_has_no_notes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(GATE, "notes")
    found = ros1.read_gate(MasterCluster("ros-master", "gate"), RELEASE)  # type: ignore[arg-type]
    assert found is not None
    assert found.notes == ()


def test_a_master_without_a_gate_is_not_asked() -> None:
    """Nor one whose gate does not run."""
    for cluster in (MasterCluster("ros-master"), MasterCluster("gate", state="waiting")):
        assert ros1.read_gate(cluster, RELEASE) is None  # type: ignore[arg-type]
        assert cluster.pods == []


def test_a_gate_that_cannot_be_asked_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    """A right that is missing, no answer: status goes on without it."""
    with socketserver.TCPServer(("127.0.0.1", 0), socketserver.BaseRequestHandler) as server:
        port = server.server_address[1]
    monkeypatch.setattr(ros1, "ASK", ros1.ASK.replace(str(pods.MASTER_PORT), str(port)))
    found = ros1.read_gate(MasterCluster("gate"), RELEASE)  # type: ignore[arg-type]
    assert found is not None
    assert "Connection refused" in found.problem

    def refuse(*_: Any, **more: Any) -> Any:
        raise Forbidden("no")

    monkeypatch.setattr(MasterCluster, "run", refuse)
    found = ros1.read_gate(MasterCluster("gate"), RELEASE)  # type: ignore[arg-type]
    assert found is not None
    assert "pods/exec" in found.problem

"""A DDS graph is read by the exporter's modules, which travel into a pod."""

from __future__ import annotations

import json
import sys
import threading
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_exporter.dds_discovery import ENDPOINTS
from rigel_exporter.dds_graph import describe
from rigel_exporter.dds_participant import Participant
from rigel_graph import dds
from rigel_graph.discovery import inside
from rigel_graph.discovery.members import members
from rigel_graph.pods import GraphPod
from rigel_graph.types import GraphNode, GraphService, GraphTopic, Mismatch
from rigel_inpod.spdp import Announcement
from rigel_k8s.errors import ClusterError
from tests.support.ddspeer import peer, some_domain
from tests.support.members import pod
from tests.support.pythons import find_python

from .local import POD, LocalCluster

PACKETS = Path(__file__).parents[1] / "exporter" / "packets"
(TALKER,) = members([pod()])


def play(name: str) -> Participant:
    """Return what one knows after a recorded conversation, before its other side leaves."""
    prefix, *messages = (bytes.fromhex(line) for line in (PACKETS / name).read_text().split())
    told = Announcement(prefix, domain=0, name="rigel-k8s x", lease=20, endpoints=ENDPOINTS)
    known = Participant(told, lambda message, places: None)
    known.hear("/chatter", 1, known.leave)
    end = max(n for n, message in enumerate(messages) if b"x" * 20 in message) + 1
    for message in messages[:end]:
        known.take(memoryview(message), "10.9.0.3", 0.0, 0.0)
    return known


@pytest.mark.parametrize("name", ["fastdds-2.14", "fastdds-3.2"])
def test_rclpys_endpoints_are_those_of_its_node(name: str) -> None:
    """The GUIDs in ros_discovery_info are those that discovery names, of humble and of later."""
    found = dds.parse(describe(play(f"{name}.hex")))
    assert found.nodes == (GraphNode("/robot/talker", address="10.9.0.3"),)
    assert {topic.name: topic.publishers for topic in found.topics} == {
        "/chatter": ("/robot/talker",),
        "/parameter_events": ("/robot/talker",),
        "/rosout": ("/robot/talker",),
    }
    (service,) = (one for one in found.services if one.name.endswith("/get_parameters"))
    assert service == GraphService(
        "/robot/talker/get_parameters", "rcl_interfaces/srv/GetParameters", ("/robot/talker",)
    )


@pytest.mark.programs
@pytest.mark.parametrize("version", ["3.9", "3"])
def test_the_modules_travel_and_join_a_domain(version: str) -> None:
    """In a Python that has none of this package, from the oldest that is promised on."""
    python = sys.executable if version == "3" else find_python(version)
    modules = [(name, "") for name in inside.PACKAGES]
    modules += [(name, inside.read_module(name)) for name in inside.MODULES]
    domain = some_domain() + 1
    config = {"domain": domain, "mode": "peers", "interface": "lo", "peers": ["127.0.0.1"]}
    answers: list[Any] = []
    cluster: Any = LocalCluster()

    def work() -> None:
        words = [json.dumps(config)]
        answers.append(inside.run_inside(cluster, POD, modules, words, pythons=[python]))

    with peer(domain) as other:
        thread = threading.Thread(target=work)
        thread.start()
        other.until(lambda: not thread.is_alive(), "the graph is read", 60)
        thread.join()
    assert dds.parse(answers[0]).nodes == (GraphNode("other"),)


ANSWER = {
    "nodes": [
        {"name": "/a", "address": "10.0.0.1", "up": True},
        {"name": "/b", "address": "10.0.0.2", "up": False},
    ],
    "writers": [
        ["/a", "rt/scan", "sensor_msgs::msg::dds_::LaserScan_"],
        ["", "rt/scan", "sensor_msgs::msg::dds_::LaserScan_"],
        ["/b", "rq/planRequest", "nav_msgs::srv::dds_::GetPlan_Request_"],
    ],
    "readers": [
        ["/b", "rt/scan", "sensor_msgs::msg::dds_::PointCloud2_"],
        ["/a", "rq/planRequest", "nav_msgs::srv::dds_::GetPlan_Request_"],
        ["/b", "plain", "Plain"],
    ],
}


def test_an_answer_becomes_topics_and_services() -> None:
    """A service is provided by who reads its requests; an endpoint of no node has no name."""
    found = dds.parse(ANSWER)
    assert found.topics == (
        GraphTopic(
            "/scan",
            "sensor_msgs/msg/LaserScan",
            ("/a",),
            ("/b",),
            (Mismatch("/b", "sensor_msgs/msg/PointCloud2"),),
        ),
        GraphTopic("plain", "Plain", (), ("/b",)),
    )
    assert found.services == (GraphService("/plan", "nav_msgs/srv/GetPlan", ("/a",)),)
    assert [node.up for node in found.nodes] == [True, False]


def test_the_way_into_discovery_is_that_of_the_nodes() -> None:
    """As their pods' annotations say: interface, peers or servers."""
    peers = attrs.evolve(TALKER, mode="peers", interface=None)
    servers = attrs.evolve(TALKER, mode="discovery-server", interface=None, servers=("a:11811",))
    assert inside.configure([TALKER], 3) == {"domain": 3, "mode": "multicast", "interface": "net1"}
    assert inside.configure([peers], 3) == {"domain": 3, "mode": "peers", "peers": ["talker-peer"]}
    assert inside.configure([servers], 3) == {
        "domain": 3,
        "mode": "discovery-server",
        "servers": ["a:11811"],
    }


def test_the_exporters_pod_is_tried_first() -> None:
    """Its image has the Python; then pods of nodes, ready ones first."""
    exporter = GraphPod("ros-exporter-1", "robots", "ros-exporter", "c", running=True)
    talker = GraphPod("talker-1", "robots", "talker", "c", running=True)
    stopped = GraphPod("stopped-1", "robots", "stopped", "c")
    inside = [TALKER, attrs.evolve(TALKER, pod="stopped-1")]
    assert dds.choose_pods([stopped, talker, exporter], inside, 3) == [exporter, talker]


@pytest.mark.programs
def test_zenoh_and_old_pythons_have_a_way_out() -> None:
    cluster: Any = LocalCluster(PATH="/nothing")
    with pytest.raises(ClusterError, match="none of its nodes uses ROS or DDS"):
        dds.read(cluster, [], [])
    zenoh = attrs.evolve(TALKER, middleware="zenoh")
    with pytest.raises(ClusterError, match="zenoh") as caught:
        dds.read(cluster, [], [zenoh])
    assert "ros2 node list" in str(caught.value.hint)
    talker = GraphPod("talker-1", "robots", "talker", "c", running=True)
    with pytest.raises(ClusterError, match="cannot listen") as caught:
        dds.read(cluster, [talker], [TALKER])
    assert "observability: {enabled: true}" in str(caught.value.hint)
    assert any("no python3" in detail for detail in caught.value.details)

"""The DDS graph of real participants on machines of namespaces, as `rigel` finds it out."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable

import pytest

from rigel_graph.discovery.findings import DiscoveryGraph
from tests.support.until import until

from .conftest import PATIENCE, ROS_NODE

pytestmark = pytest.mark.cluster

STUCK = """
import rclpy, sys, time
rclpy.init()
node = rclpy.create_node(sys.argv[1])
node.create_timer(0.1, lambda: time.sleep(3600))
print("up", flush=True)
rclpy.spin(node)
"""
TALKER = """
import rclpy, sys
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node(sys.argv[1])
publisher = node.create_publisher(String, "chatter", 10)
node.create_subscription(String, "chatter", lambda m: print("heard", m.data, flush=True), 10)
node.create_timer(0.05, lambda: publisher.publish(String(data=sys.argv[1])))
print("up", flush=True)
rclpy.spin(node)
"""


def told(graph: DiscoveryGraph) -> list[str]:
    return [f"{finding.kind}: {finding.message}" for finding in graph.problems]


def looked(look: Callable[[], DiscoveryGraph], *lines: str) -> DiscoveryGraph:
    """The graph once it tells just these lines: on a busy machine what nodes send is late."""
    end = time.monotonic() + PATIENCE
    while told(found := look()) != list(lines) and time.monotonic() < end:
        pass
    assert told(found) == list(lines)
    return found


def test_all_discover_each_other(lab):
    """Fast DDS 2 and 3 and Cyclone DDS on three machines: each is discovered in all others."""
    lab.ros("jazzy", "one")
    lab.ros("kilted", "two", "kilted")
    lab.cyclone("cyclone", "three")
    lab.ros("beside", "one")
    found = looked(lambda: lab.graph())
    names = set(lab.pods)
    for pod in found.pods:
        assert set(pod.discovered_by) == names - {pod.pod}
        assert (pod.out_of, pod.address) == (3, lab.pods[pod.pod].address)


def test_what_processes_have_discovered_is_noted(lab):
    """With the layer nothing is heard: each node names those that it has discovered itself."""
    for name, machine in (("one", "one"), ("again", "one"), ("two", "two")):
        lab.layered(name, machine)
    found = looked(lambda: lab.graph())
    assert [(pod.pod, pod.discovered_by) for pod in found.pods] == [
        ("one", ("again", "two")),
        ("again", ("one", "two")),
        ("two", ("again", "one")),
    ]


def test_machines_that_are_cut_off(lab):
    """Multicast that a switch drops is the network's fault, and one finding."""
    lab.start("first", "one", "sleep", "600")
    lab.start("second", "two", "sleep", "600")
    lab.deaf("one", "two")
    lab.deaf("two", "one")
    pods = [
        lab.layered(name, machine) for name, machine in (("a", "one"), ("b", "one"), ("c", "two"))
    ]
    members = [lab.member(pod) for pod in pods]
    text = "deaf: the pods on one and two do not discover each other"
    found = looked(lambda: lab.graph_of(members), text)
    assert found.deaf == (("one", "two"),)
    assert found.problems[0].is_error
    bare = lab.graph_of([lab.member(pod, "none") for pod in pods])
    assert "set `network`" in bare.problems[0].remedy
    assert not bare.errors


def test_a_node_in_another_domain(lab):
    """Its image may set it; nobody discovers it."""
    lab.layered("one", "one")
    lab.layered("three", "two")
    lab.python(
        "two", "two", "jazzy", ROS_NODE, "two", **{**lab.pods["one"].env, **elsewhere(lab, "two")}
    )
    found = looked(lambda: lab.graph(), "undiscovered: two is not discovered by any other pod")
    assert "ROS_DOMAIN_ID" in found.problems[0].remedy


def elsewhere(lab, name: str) -> dict[str, str]:
    """The variables of a node in another domain, with notes of its own."""
    notes = lab.folder / f"notes-{name}"
    notes.mkdir()
    return {"RIGEL_RMW": str(notes), "ROS_DOMAIN_ID": "3"}


def test_an_executor_that_stands_still(lab):
    """A callback that never returns, and a process that a signal has stopped."""
    lab.layered("one", "one")
    lab.layered("two", "one", STUCK)
    lab.layered("three", "one").signal(signal.SIGSTOP)

    def stuck() -> list[str]:
        found = lab.graph().problems
        return sorted(p.message.partition(":")[0] for p in found if p.kind == "stuck")

    until(lambda: stuck() == ["/three", "/two"], "nodes that stand still", PATIENCE)


def test_limited_discovery(lab):
    """A node whose image keeps it to its own machine is discovered by nobody."""
    lab.layered("one", "one")
    lab.layered("two", "two", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    lab.layered("three", "two")
    found = looked(lambda: lab.graph(), "undiscovered: two is not discovered by any other pod")
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" in found.problems[0].remedy


def test_messages_flow_on(lab):
    """A look disturbs nobody: messages go on, and no node logs anything."""
    one = lab.python("one", "one", "jazzy", TALKER, "one", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    lab.python("two", "two", "jazzy", TALKER, "two", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    looked(lambda: lab.graph())
    before = one.log().count("heard two")
    looked(lambda: lab.graph())
    until(lambda: one.log().count("heard two") > before, "further message")
    assert set(one.log().splitlines()) == {"up", "heard one", "heard two"}


@pytest.mark.parametrize("start", ["ros", "layered"])
def test_discovery_server(lab, start):
    """Clients of a discovery server discover each other over it."""
    where = f"{lab.discovery_server().address}:11811"
    pods = [getattr(lab, start)(name, name, ROS_DISCOVERY_SERVER=where) for name in ("one", "two")]
    clients = [lab.member(pod, "discovery-server", servers=(where,)) for pod in pods]
    looked(lambda: lab.graph_of(clients))


def test_peers(lab):
    """Without the layer, peers are found by their names, and need no multicast."""
    one, two = lab.ros("one", "one"), lab.ros("two", "two")
    looked(lambda: lab.graph("peers"))
    two.deaf_to(one)
    looked(lambda: lab.graph("peers"))
    two.drop(one)
    one.drop(two)
    looked(lambda: lab.graph("peers"), "deaf: the pods on one and two do not discover each other")

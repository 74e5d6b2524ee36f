"""The DDS graph of real participants on machines of namespaces, as `rigel` finds it out."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import rigel_inpod
from rigel_k8s.discovery.findings import DiscoveryGraph
from tests.support.until import until

from .conftest import PATIENCE

pytestmark = pytest.mark.cluster

SCRIPTS = Path(rigel_inpod.__file__).parent
#: Hears on both networks until beacons have come, and tells which stand-in heard what.
EARS = """
import sys, time
sys.path.insert(0, sys.argv[1])
sys.dont_write_bytecode = True
import dds_standin, interfaces
ears = [dds_standin.StandIn(0, {n: a}) for n, a in interfaces.addresses().items()]
print("hears", flush=True)
until = time.time() + 60
while not any(ear.beacons for ear in ears) and time.time() < until:
    for ear in ears:
        ear.listen(0.05)
for ear in ears:
    ear.listen(0.5)
print({text: sorted(n for e in ears for n in e.beacons.get(text, ()))
       for e in ears for text in e.beacons}, flush=True)
"""
#: Sends a beacon on one network.
MOUTH = """
import sys
sys.path.insert(0, sys.argv[1])
sys.dont_write_bytecode = True
import dds_standin, interfaces
name = sys.argv[2]
dds_standin.StandIn(0, {name: interfaces.address_of(name)}).beacon("over " + name)
"""
#: Tells which participants Cyclone DDS knows, whenever a line comes.
WATCHER = """
import sys, time
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsParticipant
from cyclonedds.domain import DomainParticipant
participant = DomainParticipant(0)
reader = BuiltinDataReader(participant, BuiltinTopicDcpsParticipant)
print("up", flush=True)
while True:
    for sample in reader.take(N=100):
        info = sample.sample_info
        print("+" if info.instance_state == 16 else "-", info.instance_handle, flush=True)
    time.sleep(0.1)
"""
#: Announces itself for an hour, knows somebody, and closes when a line or the end comes.
STAND_IN = """
import sys, time
sys.path.insert(0, sys.argv[1])
sys.dont_write_bytecode = True
import dds_standin, interfaces
dds_standin.LEASE = 3600
one = dds_standin.StandIn(0, interfaces.addresses())
one.announce()
until = time.time() + 60
while not one.participants and time.time() < until:
    one.listen(0.1)
sys.stdin.readline()
one.close()
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


def kinds(graph: DiscoveryGraph) -> list[str]:
    return [finding.kind for finding in graph.problems]


def settled(
    look: Callable[[], DiscoveryGraph], shows: Callable[[DiscoveryGraph], bool]
) -> DiscoveryGraph:
    """The graph once it shows something, or the last: on a busy machine what nodes send is late."""
    end = time.monotonic() + PATIENCE
    while not shows(found := look()) and time.monotonic() < end:
        pass
    return found


def looked(look: Callable[[], DiscoveryGraph], *lines: str) -> DiscoveryGraph:
    """The graph once it tells just these lines."""
    found = settled(look, lambda graph: told(graph) == list(lines))
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


def test_one_way(lab):
    """Multicast that is dropped one way between two machines: exactly that pair is named."""
    for name, machine in (("one", "one"), ("again", "one"), ("two", "two")):
        lab.ros(name, machine)
    lab.cyclone("three", "three")
    lab.deaf("two", "one")
    found = looked(lambda: lab.graph(), "deaf: multicast at net1 from two does not reach one")
    assert found.deaf == (("two", "one"),)
    assert found.problems[0].is_error


def test_both_ways(lab):
    """Two machines that are deaf to each other are one finding; a third one hears both."""
    for name in ("one", "two", "three"):
        lab.ros(name, name)
    lab.deaf("one", "two")
    lab.deaf("two", "one")
    text = "deaf: no multicast at net1 passes between one and two"
    found = looked(lambda: lab.graph(), text)
    assert found.deaf == (("one", "two"), ("two", "one"))


def test_only_the_second_network_counts(lab):
    """What arrives over the pod network proves nothing about net1, and the other way round."""
    one, two = lab.start("one", "one", "sleep", "600"), lab.start("two", "two", "sleep", "600")
    lab.default_network(one, two)
    lab.settle()
    with subprocess.Popen(
        two.entering(["python3", "-c", EARS, str(SCRIPTS)]), stdout=subprocess.PIPE, text=True
    ) as ears:
        assert ears.stdout is not None
        assert ears.stdout.readline() == "hears\n"
        assert one.exec("python3", "-c", MOUTH, str(SCRIPTS), "eth0").returncode == 0
        heard = ears.stdout.readline()
    assert heard == "{'over eth0': ['eth0']}\n"


def test_cut_off(lab):
    """A machine that hears nobody and that nobody hears is one finding, not one for each pair."""
    for name in ("one", "two", "three"):
        lab.ros(name, name)
    for name in ("two", "three"):
        lab.deaf("one", name)
        lab.deaf(name, "one")
    text = "deaf: no multicast at net1 passes between one and any other machine"
    found = looked(lambda: lab.graph(), text)
    assert len(found.deaf) == 4


def test_interface_down(lab):
    """An interface that is down is told as that, not as a network that is deaf."""
    lab.ros("one", "one")
    two = lab.ros("two", "two")
    lab.settle()
    two.ip("link", "set", "net1", "down")
    found = looked(lambda: lab.graph(), "interface-down: two has net1, but it is down")
    assert found.deaf == ()


def test_one_deaf_pod(lab):
    """A pod that is deaf while others on its machine hear is named itself."""
    one, two = lab.ros("one", "one"), lab.ros("two", "two")
    lab.ros("again", "one")
    one.deaf_to(two)
    text = "deaf-pod: multicast from two reaches the machine of one, but not this pod"
    found = looked(lambda: lab.graph(), text)
    assert found.deaf == ()


def test_no_network_key(lab):
    """On the pod network, deaf from machine to machine, it is told what to set; no error."""
    for name, machine in (("one", "one"), ("again", "one"), ("two", "two")):
        lab.ros(name, machine)
    lab.deaf("one", "two")
    lab.deaf("two", "one")
    found = settled(lambda: lab.graph("none"), lambda graph: kinds(graph) == ["deaf"])
    (finding,) = found.problems
    assert finding.message.startswith("the pods on one and two do not discover each other")
    assert "set `network`" in finding.remedy
    assert not finding.is_error
    assert {pod.pod: pod.discovered_by for pod in found.pods} == {
        "one": ("again",),
        "again": ("one",),
        "two": (),
    }


def test_wrong_domain(lab):
    """A node in another domain is named, and the domain that it is in."""
    lab.ros("one", "one")
    lab.ros("two", "two", ROS_DOMAIN_ID="3")
    looked(lambda: lab.graph(), "wrong-domain: two takes part in DDS domain 3 instead of 0")


def test_stopped(lab):
    """A stopped process is named; the others still discover each other."""
    lab.ros("one", "one")
    lab.ros("two", "two")
    lab.ros("three", "three").signal(signal.SIGSTOP)
    found = settled(lab.graph, lambda graph: kinds(graph) == ["stopped"])
    assert kinds(found) == ["stopped"]
    assert found.problems[0].message.startswith("three has a process that a signal has stopped")
    assert found.pods[0].discovered_by == ("three", "two")
    assert found.pods[2].discovered_by == ()


def test_limited_discovery(lab):
    """A node whose image keeps it to its own machine is discovered by nobody, and told."""
    lab.ros("one", "one")
    lab.ros("two", "two", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    found = looked(lambda: lab.graph(), "undiscovered: two is not discovered by any other pod")
    assert "ROS_AUTOMATIC_DISCOVERY_RANGE" in found.problems[0].remedy


def test_no_participant(lab):
    """A pod whose program has no DDS is named."""
    lab.ros("one", "one")
    lab.start("two", "two", "sleep", "600")
    looked(lambda: lab.graph(), "no-participant: two has no DDS participant")


def test_no_interface(lab):
    """Pods without their interface, or its address, are named, and explain nothing else."""
    lab.ros("one", "one")
    lab.ros("two", "two").ip("address", "flush", "dev", "net1")
    three = lab.ros("three", "three")
    lab.settle()
    three.ip("link", "set", "net1", "down")
    three.ip("link", "set", "net1", "name", "eth0")
    found = looked(
        lambda: lab.graph(),
        "no-address: two has net1 without an IPv4 address",
        "no-interface: three has no net1: Multus did not attach the second network when the"
        " pod started",
    )
    assert [pod.address for pod in found.pods] == [lab.pods["one"].address, "", ""]


def test_other_address(lab):
    """A pod that lost its promised address is named."""
    pod = lab.ros("one", "one")
    text = f"other-address: one has the address {pod.address} at net1 instead of 10.9.9.9"
    looked(lambda: lab.graph(address="10.9.9.9"), text)


def test_nobody_remembers(lab):
    """Stand-ins take their announcements back: a participant that knew them forgets them."""
    watcher = lab.python("watcher", "one", "dds", WATCHER)
    lab.ros("two", "two")
    until(lambda: watcher.log().count("+") >= 2, "node that the watcher knows", PATIENCE)

    def were_known() -> bool:
        looked(lambda: lab.graph())
        return known(watcher) >= 4

    until(were_known, "stand-ins that the watcher has known", PATIENCE)
    until(lambda: watcher.log().count("-") >= known(watcher) - 2, "end of all of them", PATIENCE)


def known(watcher) -> int:
    """How many participants the watcher has ever known: itself, the node, and stand-ins."""
    return len({line for line in watcher.log().splitlines() if line.startswith("+")})


def test_farewell(lab):
    """Closing a stand-in is enough to be forgotten, long before its lease is over."""
    watcher = lab.python("watcher", "one", "dds", WATCHER)
    lab.settle()
    line = watcher.entering(["python3", "-c", STAND_IN, str(SCRIPTS)])
    with subprocess.Popen(line, stdin=subprocess.PIPE) as stand_in:
        until(lambda: watcher.log().count("+") == 2, "stand-in that is known", PATIENCE)
    assert stand_in.returncode == 0
    until(lambda: watcher.log().count("-") >= 1, "end of the stand-in", PATIENCE)
    assert watcher.log().count("+") == 2


def test_messages_flow_on(lab):
    """A look disturbs nobody: messages go on, and no node logs anything."""
    one = lab.python("one", "one", "jazzy", TALKER, "one", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    lab.python("two", "two", "jazzy", TALKER, "two", FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    looked(lambda: lab.graph())
    before = one.log().count("heard two")
    looked(lambda: lab.graph())
    until(lambda: one.log().count("heard two") > before, "further message")
    assert set(one.log().splitlines()) == {"up", "heard one", "heard two"}


def test_discovery_server(lab):
    """Clients of a discovery server: whether it answers is told, and nothing about multicast."""
    server = lab.discovery_server()
    where = f"{server.address}:11811"
    pods = [lab.ros(name, name, ROS_DISCOVERY_SERVER=where) for name in ("one", "two")]
    clients = [lab.member(pod, "discovery-server", servers=(where,)) for pod in pods]
    looked(lambda: lab.graph_of(clients))
    server.signal(signal.SIGSTOP)
    text = f"gets no answer from the discovery server {where}"
    looked(lambda: lab.graph_of(clients), f"no-server: one {text}", f"no-server: two {text}")


def test_peers(lab):
    """Static peers are asked by name; who does not answer is told by whom."""
    one, two = lab.ros("one", "one"), lab.ros("two", "two")
    looked(lambda: lab.graph("peers"))
    two.deaf_to(one)  # multicast only: peers do not need it
    looked(lambda: lab.graph("peers"))
    two.drop(one)
    looked(
        lambda: lab.graph("peers"),
        "undiscovered: one is not discovered by any other pod",
        "undiscovered: two is not discovered by any other pod",
    )


def test_zenoh(lab):
    """Who is connected to no zenoh router is named."""
    router = lab.router("one")
    client = lab.zenoh("one", "one", router)
    alone = lab.start("two", "two", "sleep", "600")
    members = [lab.member(p, "zenoh", middleware="zenoh") for p in (client, alone)]
    text = "no-router: two is not connected to a zenoh router"
    found = looked(lambda: lab.graph_of(members), text)
    assert found.pods[0].reaches == (router.address,)


def test_without_python(lab):
    """A pod in which nothing can look is said to be unknown, not wrong."""
    lab.ros("one", "one")
    two = lab.ros("two", "two")
    two.env["PATH"] = "/nowhere"
    found = settled(lab.graph, lambda graph: [[*f.subjects] for f in graph.problems] == [["two"]])
    (finding,) = found.problems
    assert (finding.kind, finding.is_error, list(finding.subjects)) == (
        "not-looked",
        False,
        ["two"],
    )


def test_domain_of_the_image(lab):
    """Where nobody told a domain, each is looked at in its own."""
    lab.ros("one", "one", ROS_DOMAIN_ID="7")
    lab.ros("two", "two", ROS_DOMAIN_ID="7")
    found = looked(lambda: lab.graph("none", domain=None))
    assert [pod.discovered_by for pod in found.pods] == [("two",), ("one",)]

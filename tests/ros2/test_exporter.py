"""The exporter's DDS half against real participants: rclpy on Fast DDS, Cyclone DDS, a server."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import attrs
import pytest

import rigel_k8s
from rigel_exporter import messages

from .conftest import PATIENCE

pytestmark = pytest.mark.cluster


def slow(*cases: object) -> list[object]:
    """Return parameters of tests that run with --all only."""
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in cases
    ]


SOURCES = str(Path(rigel_k8s.__file__).parents[1])

#: exporter.py ARGUMENTS-AS-JSON TOPIC...: a line of JSON five times a second.
EXPORTER = """
import json, sys, time
from rigel_exporter.dds import Domain

domain = Domain(**json.loads(sys.argv[1]))
topics = {topic: domain.subscribe(topic, keep=1) for topic in sys.argv[2:]}
payloads = {topic: [] for topic in topics}
domain.start()
while True:
    graph = domain.look()
    samples = {topic: heard.samples() for topic, heard in topics.items()}
    for topic, heard in samples.items():
        payloads[topic] = [p.hex() for p in heard.payloads] or payloads[topic]
    print(json.dumps({
        "nodes": {node.name: node.up for node in graph.nodes},
        "topics": {topic.name: topic[1:] for topic in graph.topics},
        "samples": {topic: heard[:4] + (payloads[topic],) for topic, heard in samples.items()},
        "cpu": time.process_time(),
    }), flush=True)
    time.sleep(0.2)
"""
#: talker.py NAME SIZE COUNT: waits for a subscriber of /chatter, sends, says whom /silent has.
#: Large samples come slowly: the socket of a busy subscriber cannot hold two of them.
TALKER = """
import sys, rclpy
from std_msgs.msg import String
name, size, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
rclpy.init()
node = rclpy.create_node(name, namespace="/robot")
chatter = node.create_publisher(String, "/chatter", 10)
silent = node.create_publisher(String, "/silent", 10)
print("up", flush=True)
sent = 0
def send():
    global sent
    if sent < count and chatter.get_subscription_count():
        sent += 1
        chatter.publish(String(data="x" * size))
        silent.publish(String(data="y"))
        if sent == count:
            readers = silent.get_subscription_count(), node.count_subscribers("/silent")
            print("sent", *readers, node.count_subscribers("/chatter"), flush=True)
timer = node.create_timer(0.05 if size < 10000 else 0.25, send)
rclpy.spin(node)
"""
LISTENER = """
import sys, rclpy, signal
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node(sys.argv[1])
node.create_subscription(String, "/chatter", lambda message: None, 10)
print("up", flush=True)
rclpy.spin(node)
"""
#: A type of ROS' name and a topic of another DDS, with the definitions of ROS' .msg files.
STAMPED = """
import sys, time
from dataclasses import dataclass
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import byte, float64, int32, sequence, uint32
from cyclonedds.pub import DataWriter
from cyclonedds.topic import Topic

@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32

@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str

@dataclass
class KeyValue(IdlStruct, typename="diagnostic_msgs::msg::dds_::KeyValue_"):
    key: str
    value: str

@dataclass
class Status(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticStatus_"):
    level: byte
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]

@dataclass
class Diagnostics(IdlStruct, typename="diagnostic_msgs::msg::dds_::DiagnosticArray_"):
    header: Header
    status: sequence[Status]

@dataclass
class Transform(IdlStruct, typename="geometry_msgs::msg::dds_::TransformStamped_"):
    header: Header
    child_frame_id: str
    x: float64
    y: float64
    z: float64
    a: float64
    b: float64
    c: float64
    d: float64

@dataclass
class Tf(IdlStruct, typename="tf2_msgs::msg::dds_::TFMessage_"):
    transforms: sequence[Transform]

participant = DomainParticipant(0)
header = Header(Time(100, 500000000), "map")
statuses = [Status(2, "motor", "hot", "m1", [KeyValue("t", "99")]), Status(0, "lidar", "", "", [])]
transforms = [Transform(header, child, 0, 0, 0, 0, 0, 0, 1) for child in ("odom", "base")]

def writer(topic, kind, sample):
    return DataWriter(participant, Topic(participant, topic, kind)), sample

writers = [
    writer("rt/diagnostics", Diagnostics, Diagnostics(header, statuses)),
    writer("rt/tf", Tf, Tf(transforms)),
    writer("plain", Time, Time(1, 2)),
]
print("up", flush=True)
while True:
    for writer, sample in writers:
        writer.write(sample)
    time.sleep(0.1)
"""

#: many.py PARTICIPANTS TOPICS: a writer and a reader of each topic, on participants in turn.
MANY = """
import sys, time
from dataclasses import dataclass
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

@dataclass
class Text(IdlStruct, typename="std_msgs::msg::dds_::String_"):
    data: str

participants = [DomainParticipant(0) for _ in range(int(sys.argv[1]))]
kept = []
for number in range(int(sys.argv[2])):
    one, other = (participants[(number + i) % len(participants)] for i in (0, 1))
    kept.append(DataWriter(one, Topic(one, f"rt/topic_{number}", Text)))
    kept.append(DataReader(other, Topic(other, f"rt/topic_{number}", Text)))
print("up", flush=True)
time.sleep(600)
"""


@attrs.frozen
class Exporter:
    """The exporter in a pod of its own."""

    pod: object

    def until(self, found):
        """What it tells once `found` is true of it."""
        end, now = time.monotonic() + PATIENCE, None
        while now is None or not found(now):
            assert time.monotonic() < end, now
            assert self.pod.process.poll() is None, self.pod.log()
            time.sleep(0.1)
            lines = self.pod.log().splitlines()[:-1]  # the last one may be half written
            now = json.loads(lines[-1]) if lines else None
        return now


@pytest.fixture
def exporter(lab):
    """Starts the exporter."""

    def start(*topics, interface="net1", **arguments):
        words = [json.dumps({"interface": interface, **arguments}), *topics]
        pod = lab.start(
            "exporter", "one", sys.executable, "-c", EXPORTER, *words, PYTHONPATH=SOURCES
        )
        lab.settle()
        return Exporter(pod)

    return start


def talker(lab, name="talker", size=1, count=0, machine="one", distro="jazzy", **env):
    env = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **env}
    return lab.python(name, machine, distro, TALKER, name, str(size), str(count), **env)


def listener(lab, name="listener", machine="one", distro="jazzy", **env):
    env = {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **env}
    return lab.python(name, machine, distro, LISTENER, name, **env)


def counts(told, topic="/chatter"):
    """(publishers, subscribers) of a topic."""
    found = told["topics"].get(topic)
    return found and tuple(found[1:])


@pytest.mark.parametrize("distro", ["jazzy", *slow("kilted")])
def test_graph_follows_the_nodes(lab, exporter, distro):
    """Nodes by ROS name, topics with ROS type and endpoints; both follow who comes and who ends."""
    talker(lab, distro=distro)
    one = listener(lab, "one", distro=distro)
    seen = exporter()
    chatter, silent = ["std_msgs/msg/String", 1, 1], ["std_msgs/msg/String", 1, 0]
    both = {"/robot/talker": True, "/one": True}
    told = seen.until(
        lambda told: (
            told["nodes"] == both
            and [told["topics"].get(name) for name in ("/chatter", "/silent")] == [chatter, silent]
        )
    )
    assert not [name for name in told["topics"] if not name.startswith("/") or "get_type" in name]
    listener(lab, "two", machine="two", distro=distro)
    seen.until(lambda told: counts(told) == (1, 2) and len(told["nodes"]) == 3)
    one.signal(signal.SIGINT)
    left = {"/robot/talker": True, "/two": True}
    seen.until(lambda told: counts(told) == (1, 1) and told["nodes"] == left)


@pytest.mark.parametrize("mode", ["multicast", *slow("peers", "discovery-server")])
def test_silent_nodes(lab, exporter, mode):
    """A stopped and a killed node are down while their lease still holds, the others stay up."""
    env, arguments = way(lab, mode)
    stopped = talker(lab, **env)
    killed = listener(lab, "killed", **env)
    listener(lab, "healthy", **env)
    seen = exporter(mode=mode, **arguments)
    everybody = {"/robot/talker": True, "/killed": True, "/healthy": True}
    seen.until(lambda told: told["nodes"] == everybody and counts(told) == (1, 2))
    stopped.signal(signal.SIGSTOP)
    seen.until(lambda told: told["nodes"] == {**everybody, "/robot/talker": False})
    stopped.signal(signal.SIGCONT)
    seen.until(lambda told: told["nodes"] == everybody)
    killed.kill()
    seen.until(lambda told: told["nodes"] == {**everybody, "/killed": False})
    if mode != "peers":  # as by multicast
        seen.until(lambda told: "/killed" not in told["nodes"] and counts(told) == (1, 1))


def way(lab, mode):
    """(environment of nodes, arguments of the exporter) in a mode."""
    if mode == "discovery-server":
        server = f"{lab.discovery_server().address}:11811"
        return {"ROS_DISCOVERY_SERVER": server}, {"servers": [server]}
    if mode == "peers":
        names = ["talker-peer", "killed-peer", "healthy-peer", "nobody-peer"]
        return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, {"peers": names}
    return {}, {}


@pytest.mark.parametrize(
    ("size", "distro"), [(20, "jazzy"), (1_000_000, "jazzy"), *slow((20, "kilted"))]
)
def test_named_topic(lab, exporter, size, distro):
    """Each sample of a named topic counts, whole or in fragments; nobody else is subscribed to."""
    seen = exporter("/chatter")
    pod = talker(lab, size=size, count=40, distro=distro)
    told = seen.until(lambda told: "sent" in pod.log() and told["samples"]["/chatter"][0] >= 40)
    messages, total, last, stamp, _ = told["samples"]["/chatter"]
    payload = 4 + 4 + size + 1  # encapsulation, length, text, its end
    assert (messages, total) == (40, 40 * (payload + -payload % 4)) or total == 40 * payload
    assert 0 <= time.time() - last < PATIENCE
    assert stamp is None
    assert pod.log().split("sent")[1].split() == ["0", "0", "1"], "matched, known readers"


def test_other_dds(lab, exporter):
    """Cyclone DDS: names, stamps, /diagnostics and /tf; plain topics under their own names."""
    pod = lab.python("cyclone", "one", "dds", STAMPED)
    seen = exporter("/diagnostics", "/tf", "plain")
    told = seen.until(lambda told: all(s[0] > 2 for s in told["samples"].values()))
    assert told["topics"]["/diagnostics"][0] == "diagnostic_msgs/msg/DiagnosticArray"
    assert counts(told, "plain") == (1, 0)
    diagnostics, tf, plain = (told["samples"][t] for t in ("/diagnostics", "/tf", "plain"))
    assert (diagnostics[3], tf[3], plain[3]) == (100.5, 100.5, None)
    statuses = [("motor", "m1", 2), ("lidar", "", 0)]
    assert messages.diagnostics(messages.cdr(bytes.fromhex(diagnostics[4][0]))) == statuses
    transforms = [("map", "odom", 100.5), ("map", "base", 100.5)]
    assert messages.transforms(messages.cdr(bytes.fromhex(tf[4][0]))) == transforms
    [name] = told["nodes"]
    pod.signal(signal.SIGSTOP)
    seen.until(lambda told: told["nodes"] == {name: False})


@pytest.mark.timing
def test_many(lab, exporter):
    """50 participants and 200 topics are all found, and cost a fifth of a processor at most."""
    lab.python("many", "one", "dds", MANY, "50", "200")
    seen = exporter("/topic_7")
    told = seen.until(lambda told: [counts(told, t) for t in told["topics"]] == [(1, 1)] * 200)
    begin, cpu = time.monotonic(), told["cpu"]
    time.sleep(10)
    told = seen.until(lambda told: told["cpu"] > cpu)
    assert (told["cpu"] - cpu) / (time.monotonic() - begin) < 0.2, "looks included, five a second"


def test_server_that_starts_anew(lab, exporter):
    """A discovery server that is restarted under its old GUID is followed again."""
    pod = lab.discovery_server()
    server = f"{pod.address}:11811"
    listener(lab, ROS_DISCOVERY_SERVER=server)
    seen = exporter(mode="discovery-server", servers=[server])
    seen.until(lambda told: counts(told) == (0, 1))
    pod.kill()
    environment = {**os.environ, "HOSTS": str(lab.hosts)}
    again = subprocess.Popen(pod.process.args, env=environment, stdout=subprocess.DEVNULL)
    lab.cleanup.callback(again.wait)
    lab.cleanup.callback(again.kill)
    talker(lab, ROS_DISCOVERY_SERVER=server)
    everybody = {"/robot/talker": True, "/listener": True}
    seen.until(lambda told: counts(told) == (1, 1) and told["nodes"] == everybody)


def test_restarts(lab, exporter):
    """An interface and publishers that come back are taken up again."""
    seen = exporter("/chatter")
    pod = talker(lab, count=1000)
    seen.until(lambda told: told["samples"]["/chatter"][0] > 5)
    seen.pod.ip("address", "flush", "dev", "net1")
    seen.until(lambda told: told["nodes"] == {"/robot/talker": False})
    seen.pod.ip("address", "add", f"{seen.pod.address}/24", "dev", "net1")
    seen.until(lambda told: told["nodes"] == {"/robot/talker": True})
    pod.kill()
    count = seen.until(lambda told: told["nodes"] == {"/robot/talker": False})["samples"][
        "/chatter"
    ][0]
    talker(lab, count=1000)
    seen.until(lambda told: told["samples"]["/chatter"][0] > count + 5)

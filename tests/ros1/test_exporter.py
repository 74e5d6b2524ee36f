"""The ROS exporter beside a real roscore and real rospy and roscpp nodes."""

from __future__ import annotations

import json
import re
import signal

import pytest

from rigel_lab.images.exporter import entries

pytestmark = pytest.mark.cluster

EXPORTER = ("/usr/bin/python3", "-m", "rigel_exporter", "/config.json")
RELAY = ("rosrun", "topic_tools", "relay", "/chatter", "/relayed", "__name:=relay")
TALKER = """#!/usr/bin/env python
import sys
import rospy
from std_msgs.msg import String
rospy.init_node(sys.argv[1])
publishers = [rospy.Publisher(name, String, queue_size=1) for name in ("/chatter", "/unnamed")]
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    for publisher in publishers:
        publisher.publish("hello")
    rate.sleep()
"""
#: Publishes messages by their bytes: the image has neither diagnostic_msgs nor tf2_msgs.
BYTES = """#!/usr/bin/env python
import struct
import genpy
import rospy
from rosgraph_msgs.msg import Clock

def kind(name, fields):
    class Raw(genpy.Message):
        _type, _md5sum, _full_text, _has_header = name, "0" * 32, fields, False
        __slots__ = ["data"]
        _slot_types = ["string"]
        def serialize(self, buff):
            buff.write(self.data)
        def deserialize(self, data):
            return self
    return Raw

def text(value):
    return struct.pack("<I", len(value)) + value.encode()

def header(stamp, frame):
    return struct.pack("<III", 0, int(stamp), 0) + text(frame)

rospy.init_node("bytes")
stamped = kind("t/Stamped", "Header header\\nuint8[] data")
array = kind("diagnostic_msgs/DiagnosticArray", "Header header\\nDiagnosticStatus[] status")
frames = kind("tf2_msgs/TFMessage", "geometry_msgs/TransformStamped[] transforms")
kinds = {"/camera": stamped, "/diagnostics": array, "/tf": frames, "/clock": Clock}
publish = {name: rospy.Publisher(name, k, queue_size=1) for name, k in kinds.items()}
while not rospy.is_shutdown():
    now = rospy.get_time()
    picture = header(now - 5, "lens") + bytes(200000)
    status = bytes([2]) + text("motor") + text("hot") + text("m1")
    status += struct.pack("<I", 1) + text("k") + text("v")
    publish["/camera"].publish(stamped(data=picture))
    publish["/diagnostics"].publish(array(data=header(now, "") + struct.pack("<I", 1) + status))
    turn = header(now - 7, "map") + text("base") + bytes(56)
    publish["/tf"].publish(frames(data=struct.pack("<I", 1) + turn))
    publish["/clock"].publish(Clock(rospy.Time.from_sec(now)))
    rospy.rostime.wallsleep(0.2)
"""


def root(**config) -> dict[str, str]:
    """The exporter's own files and its configuration, for a pod's root."""
    program = {f"/{entry.path}": entry.content.decode() for entry in entries()}
    return {**program, "/config.json": json.dumps({"interval": 0.5, **config})}


def exporter(pods, eventually, **config):
    """Start the exporter and wait until it has looked."""
    files = root(master_uri=pods.master_uri, **config)
    env = {"PYTHONPATH": "/opt/rigel-k8s"}
    pod = pods.start("exporter", *EXPORTER, files=files, env=env, entrypoint=False)
    eventually(lambda: get(pod, "healthz") == "ok\n", "the exporter is well")
    return pod


def get(pod, path: str) -> str:
    """What the exporter answers; the error's text where it does not."""
    ask = f"u.urlopen('http://localhost:9419/{path}').read().decode()"
    line = f"import urllib.request as u; print({ask}, end='')"
    return pod.exec("python3", "-c", line).stdout


class Metrics:
    """One scrape: metric -> labels -> value."""

    def __init__(self, pod) -> None:
        self.text = get(pod, "metrics")
        self.values = dict(
            re.fullmatch(r"(.+) (\S+)", line).groups()
            for line in self.text.splitlines()
            if not line.startswith("#")
        )

    def __call__(self, name: str, /, **labels: str) -> float | None:
        inside = ",".join(f'{key}="{value}"' for key, value in labels.items())
        found = self.values.get(f"{name}{{{inside}}}")
        return None if found is None else float(found)

    def node(self, what: str, name: str, workload: str = "") -> float | None:
        return self(f"ros_node_{what}", ros_node=name, workload=workload)

    def ends(self, what: str, topic: str, kind: str = "std_msgs/String") -> float | None:
        return self(f"ros_topic_{what}", topic=topic, type=kind)

    def counted(self, what: str, node: str, topic: str, direction: str) -> float | None:
        labels = {"ros_node": node, "topic": topic, "direction": direction}
        return self(f"ros_node_topic_{what}_total", **labels)


def talker(pods, name: str = "talker"):
    return pods.node(name, "python3", "/talker.py", name, files={"/talker.py": TALKER})


def subscribers_at_master(pods, pod) -> str:
    """What the master itself says of all topics' subscribers, asked from another pod."""
    done = pod.exec("/bin/sh", "/rigel-k8s/exec.sh", "rostopic", "list", "-v")
    return done.stdout


def test_the_graph_is_told_without_a_subscription(pods, eventually):
    """Nodes, topics and the nodes' own counts; the master knows of no exporter at all."""
    pods.rosmaster()
    spoken = talker(pods)
    pods.node("relay", *RELAY)
    seen = exporter(pods, eventually, expected={"/talker": "talker", "/lidar": "laser"})
    ends = (("/talker", "published"), ("/relay", "received"))

    def look() -> Metrics | None:
        """A look at which both nodes have answered: on a busy machine one may be too late."""
        now = Metrics(seen)
        counts = [now.counted("messages", node, "/chatter", way) or 0 for node, way in ends]
        up = (now.node("up", "/talker", "talker"), now.node("up", "/relay"))
        return now if min(counts) > 5 and up == (1, 1) else None

    now = eventually(look, "the messages are counted at both ends")
    assert now("ros_exporter_info", version="0.1.0", ros="1", middleware="") == 1
    assert now("ros_master_up") == 1
    assert now("ros_master_restarts_total") == 0
    assert now("ros_master_start_time_seconds") > 1e9
    assert now.node("up", "/talker", "talker") == 1
    assert now.node("registered", "/talker", "talker") == 1
    assert now.node("missing_registrations", "/talker", "talker") == 0
    assert now.node("up", "/relay") == 1
    assert now.node("up", "/lidar", "laser") == 0
    assert now.node("registered", "/lidar", "laser") == 0
    assert now.ends("publishers", "/chatter") == 1
    assert now.ends("subscribers", "/chatter") == 1
    assert now.ends("publishers", "/unnamed") == 1
    assert now.ends("subscribers", "/unnamed") == 0
    assert now.counted("messages", "/relay", "/chatter", "received") > 5
    assert now.counted("bytes", "/relay", "/chatter", "received") > 50
    assert now("process_resident_memory_bytes") > 1e6
    assert "/ros_exporter" not in now.text
    assert "ros_exporter" not in subscribers_at_master(pods, spoken)


def test_only_named_topics_are_heard_at_their_rate(pods, eventually):
    """20 messages a second are counted as 20; the unnamed topic has no subscriber at the master."""
    pods.rosmaster()
    spoken = talker(pods)
    seen = exporter(pods, eventually, topics=["/chatter", "/silent"])
    eventually(lambda: Metrics(seen)("ros_topic_messages_total", topic="/chatter"), "it is heard")

    def measure() -> tuple[Metrics, Metrics] | None:
        """Two looks, 60 messages apart, between which the talker could keep to its rate."""
        first = Metrics(seen)
        eventually(lambda: count(Metrics(seen)) >= count(first) + 60, "60 messages are heard")
        last = Metrics(seen)
        rate = (count(last) - count(first)) / (arrived(last) - arrived(first))
        return (first, last) if rate == pytest.approx(20, rel=0.35) else None

    def count(metrics: Metrics) -> float:
        return metrics("ros_topic_messages_total", topic="/chatter")

    def arrived(metrics: Metrics) -> float:
        return metrics("ros_topic_last_message_timestamp_seconds", topic="/chatter")

    first, last = eventually(measure, "20 messages in a second are counted as 20")
    heard = [count(m) for m in (first, last)]
    sizes = [m("ros_topic_bytes_total", topic="/chatter") for m in (first, last)]
    assert (sizes[1] - sizes[0]) / (heard[1] - heard[0]) == 9
    assert last("ros_topic_last_message_timestamp_seconds", topic="/chatter") > 1e9
    assert last("ros_topic_messages_total", topic="/silent") == 0
    assert last.ends("subscribers", "/chatter") == 0, "the exporter itself is not counted"
    state = subscribers_at_master(pods, spoken)
    assert " * /chatter [std_msgs/String] 1 subscriber" in state
    assert not re.search(r"/unnamed.*subscriber", state)
    seen.terminate()
    assert not re.search(r"/chatter.*subscriber", subscribers_at_master(pods, spoken))


def test_a_stopped_node_is_not_up_and_a_vanished_one_neither(pods, eventually):
    """SIGSTOP leaves it registered; a killed pod too; the others are up all the time."""
    pods.rosmaster()
    talker(pods)
    stopped, killed = talker(pods, "stopped"), talker(pods, "killed")
    seen = exporter(pods, eventually)
    stopped.signal("/talker.py", signal.SIGSTOP)
    killed.kill()
    eventually(lambda: Metrics(seen).node("up", "/stopped") == 0, "the stopped one is not up")
    eventually(lambda: Metrics(seen).node("up", "/killed") == 0, "the killed one is not up")
    now = Metrics(seen)
    assert now.node("registered", "/stopped") == now.node("registered", "/killed") == 1
    eventually(lambda: Metrics(seen).node("up", "/talker") == 1, "the other one is up")
    stopped.signal("/talker.py", signal.SIGCONT)
    eventually(lambda: Metrics(seen).node("up", "/stopped") == 1, "it goes on")


def test_a_stopped_master_is_not_up_and_no_other_one_afterwards(pods, eventually):
    """It hangs for a while; scrapes are answered all the time, and nothing has restarted."""
    master = pods.rosmaster()
    talker(pods)
    seen = exporter(pods, eventually)
    eventually(lambda: Metrics(seen).node("up", "/talker") == 1, "the talker is up")
    master.signal("rosmaster", signal.SIGSTOP)
    eventually(lambda: Metrics(seen)("ros_master_up") == 0, "the master does not answer")
    master.signal("rosmaster", signal.SIGCONT)
    eventually(lambda: Metrics(seen)("ros_master_up") == 1, "it goes on")
    assert Metrics(seen)("ros_master_restarts_total") == 0
    eventually(lambda: Metrics(seen).node("up", "/talker") == 1, "the talker is up again")


def test_a_restarted_master_is_counted_and_its_orphans_are_told(pods, eventually):
    """The old nodes are alive and unregistered; the exporter itself registers again."""
    master = pods.rosmaster()
    old = talker(pods)
    seen = exporter(pods, eventually, topics=["/chatter"])
    eventually(lambda: Metrics(seen).node("up", "/talker") == 1, "the talker is up")
    master.kill()
    eventually(lambda: Metrics(seen)("ros_master_up") == 0, "the master is gone")
    assert Metrics(seen).node("up", "/talker") == 0
    fresh = pods.start("ros-master", "roscore", address=master.address)
    pods.answering(fresh)
    eventually(lambda: Metrics(seen)("ros_master_restarts_total") == 1, "the restart is counted")
    eventually(lambda: Metrics(seen).node("missing_registrations", "/talker") == 3, "its topics")
    now = Metrics(seen)
    assert now.node("up", "/talker") == now.node("registered", "/talker") == 0
    old.kill()
    spoken = talker(pods, "another")
    before = Metrics(seen)("ros_topic_messages_total", topic="/chatter")
    eventually(
        lambda: Metrics(seen)("ros_topic_messages_total", topic="/chatter") > before + 10,
        "the new publisher is heard",
    )
    assert Metrics(seen)("ros_master_restarts_total") == 1
    state = subscribers_at_master(pods, spoken)
    assert " * /chatter [std_msgs/String] 1 subscriber" in state, "it is told of new publishers"


def test_diagnostics_clock_tf_and_headers_are_read_on_request(pods, eventually):
    """Levels by name and hardware, ages by stamp; a large message costs no memory."""
    pods.rosmaster()
    pods.node("bytes", "python3", "/bytes.py", files={"/bytes.py": BYTES})
    asked = {"diagnostics": True, "clock": True, "tf": True, "topics": ["/camera"]}
    seen = exporter(pods, eventually, **asked)
    level = {"name": "motor", "hardware_id": "m1"}
    eventually(lambda: Metrics(seen)("ros_diagnostics_level", **level) == 2, "the level is told")
    eventually(lambda: Metrics(seen)("ros_clock_age_seconds") is not None, "the clock is heard")
    eventually(lambda: Metrics(seen)("ros_topic_messages_total", topic="/camera"), "the camera")
    frames = {"parent": "map", "child": "base"}
    eventually(lambda: Metrics(seen)("ros_tf_age_seconds", **frames) is not None, "the transform")
    now = Metrics(seen)
    assert 0 <= now("ros_clock_age_seconds") < 20
    assert 6 < now("ros_tf_age_seconds", **frames) < 30
    assert 4.9 < now("ros_topic_header_age_seconds", topic="/camera") < 30
    assert now("ros_topic_bytes_total", topic="/camera") > 200000
    assert now("ros_topic_messages_total", topic="/tf") is None, "nobody named it"
    assert now("ros_exporter_failures_total") == 0


def test_a_missing_master_is_told_and_delays_no_start(pods, eventually):
    """Before there is a master the expected nodes are down and the exporter answers."""
    pods.master_uri = "http://10.123.0.99:11311"
    seen = exporter(pods, eventually, expected={"/talker": "talker"}, topics=["/chatter"])
    now = Metrics(seen)
    assert now("ros_master_up") == 0
    assert now.node("up", "/talker", "talker") == 0
    assert now("ros_master_start_time_seconds") is None
    assert seen.terminate() < 20

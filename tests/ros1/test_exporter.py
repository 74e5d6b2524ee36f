"""The ROS exporter beside a real roscore and real rospy and roscpp nodes."""

from __future__ import annotations

import json
import re

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

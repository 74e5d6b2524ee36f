"""The exporter's program, the keepers of real pods, and real nodes with the layer."""

from __future__ import annotations

import json
import re
import sys

import attrs
import pytest

from rigel_k8s.network.modes.peers import peer_name
from tests.support.until import until

from .conftest import PATIENCE, Pod, run
from .test_exporter import SOURCES

pytestmark = pytest.mark.cluster

#: talker.py COUNT: sends so many messages once it has a subscriber.
TALKER = """
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("talker")
publisher, left = node.create_publisher(String, "/chatter", 100), int(sys.argv[1])
def send():
    global left
    if left and publisher.get_subscription_count():
        left -= 1
        publisher.publish(String(data="x"))
node.create_timer(0.02, send)
print("up", flush=True)
rclpy.spin(node)
"""
LISTENER = """
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(String, "/chatter", lambda _: None, 100)
print("up", flush=True)
rclpy.spin(node)
"""
GET = (
    "import urllib.request as u; print(u.urlopen('http://127.0.0.1:9419/metrics').read().decode())"
)
COUNT = 60


def keep(lab, name, code, *words):
    """Start a pod whose program has the layer, and a keeper beside it, as a release does."""
    folder = lab.scripts()
    env = {
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
        "ROS_DOMAIN_ID": "70",
        "RIGEL_RMW": str(lab.folder / f"notes-{name}"),
        "RIGEL_K8S_WORKLOAD": name,
    }
    python = str(lab.venv("jazzy") / "bin" / "python")
    line = ["/bin/sh", str(folder / "rmw.sh"), python, "-c", code, *words]
    pod = lab.start(name, "one", *line, **env)
    until(lambda: "up" in pod.log(), f"start of {name}", PATIENCE)
    return pod


@attrs.frozen
class Metrics:
    """What the exporter's program serves."""

    pod: Pod

    def read(self):
        """Return each series with its value."""
        lines = self.pod.exec(sys.executable, "-c", GET).stdout.splitlines()
        found = (line.rpartition(" ") for line in lines if line and line[0] != "#")
        return {name: float(value) for name, _, value in found}

    def of(self, family):
        """Return a family's values by the node; of topics, those of /chatter."""
        values = {}
        for name, value in self.read().items():
            match = re.match(rf'{family}{{ros_node="([^"]*)"(?:,topic="/chatter"|,workload)', name)
            if match:
                values[match[1]] = value
        return values


@pytest.fixture
def metrics(lab):
    """Starts the exporter for the pods that run."""

    def start():
        keepers = [f"{peer_name(name)}:11399" for name in (*lab.pods, "absent")]
        config = {"ros": "2", "keepers": keepers, "interval": 0.5, "topics": ["/chatter"]}
        config["expected"] = {"/talker": "talker", "/absent": "absent"}
        wanted = {"type": "std_msgs/String", "rate": [0.1, 1e6], "age": PATIENCE}
        config["contract"] = {"/chatter": {**wanted, "publishers": [2, 2]}}
        path = lab.folder / "config.json"
        path.write_text(json.dumps(config))
        line = [sys.executable, "-m", "rigel_exporter", str(path)]
        pod = lab.start("exporter", "one", *line, PYTHONPATH=SOURCES)
        until(lambda: "serving" in pod.log(), "start of the exporter", PATIENCE)
        return Metrics(pod)

    return start


def test_every_message_is_counted_once(lab, metrics):
    """At both ends, without a participant of our own; also when a keeper has been restarted."""
    listener = keep(lab, "listener", LISTENER)
    keep(lab, "talker", TALKER, str(COUNT))
    seen = metrics()
    lab.settle()
    both = {"/talker": COUNT, "/listener": COUNT}

    def counts():
        found = seen.of("ros_node_topic_messages_total")
        return {node: found.get(node) for node in both}

    until(lambda: counts() == both, "all messages", PATIENCE)
    found = seen.read()
    assert found['ros_topic_messages_total{topic="/chatter"}'] == COUNT
    assert found['ros_topic_publishers{topic="/chatter",type="std_msgs/msg/String"}'] == 1
    ends = '{0}{{ros_node="/listener",topic="/chatter",direction="received"}}'
    assert found[ends.format("ros_node_topic_partners")] == 1
    assert found[ends.format("ros_node_topic_longest_gap_seconds")] > 0
    for family in ("refused", "dropped"):
        assert found[ends.format(f"ros_node_topic_{family}_total")] == 0
    of = 'ros_topic_as_expected{{topic="/chatter",expectation="{}"}}'
    kinds = {"type": 1, "rate": 1, "age": 1, "publishers": 0}
    assert {kind: found[of.format(kind)] for kind in kinds} == kinds
    age = found['ros_node_topic_age_seconds{ros_node="/listener",topic="/chatter"}']
    assert 0 < age < PATIENCE
    assert seen.of("ros_node_up") == {"/talker": 1, "/listener": 1, "/absent": 0}
    sockets = seen.pod.exec("cat", "/proc/net/udp", "/proc/net/udp6").stdout.splitlines()
    assert [line for line in sockets if "local_address" not in line] == []
    keeper = json.loads((lab.folder / "notes-listener" / "keeper.json").read_text())["pid"]
    assert listener.exec("kill", "-9", str(keeper)).returncode == 0
    until(lambda: "/listener" not in seen.of("ros_node_topic_partners"), "its end", PATIENCE)
    until(lambda: counts() == both, "its next start", PATIENCE)


def test_a_node_that_ends_is_down(lab, metrics):
    """Its keeper answers for it no more, and the other nodes do not have it any longer."""
    keep(lab, "listener", LISTENER)
    talker = keep(lab, "talker", TALKER, "0")
    seen = metrics()
    lab.settle()
    until(lambda: seen.of("ros_node_up").get("/talker") == 1, "the talker", PATIENCE)
    talker.kill()
    until(lambda: seen.of("ros_node_up").get("/talker") == 0, "its end", PATIENCE)


#: Sends images as a camera does: best effort, 20 a second.
CAMERA = """
import array, rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import UInt8MultiArray
rclpy.init()
node = rclpy.create_node("camera")
publisher = node.create_publisher(UInt8MultiArray, "/camera/image", qos_profile_sensor_data)
image = UInt8MultiArray(data=array.array("B", bytes(400_000)))
node.create_timer(0.05, lambda: publisher.publish(image))
print("up", flush=True)
rclpy.spin(node)
"""
DETECTOR = """
import rclpy
from rclpy.qos import qos_profile_sensor_data
from std_msgs.msg import UInt8MultiArray
rclpy.init()
node = rclpy.create_node("detector")
show = lambda _: print("image", flush=True)
node.create_subscription(UInt8MultiArray, "/camera/image", show, qos_profile_sensor_data)
print("up", flush=True)
rclpy.spin(node)
"""


def test_a_topic_that_loses_large_messages_is_named(lab):
    """Both ends count exactly; a network that drops fragments lets no image through."""
    detector = lab.layered("detector", "one", DETECTOR)
    lab.layered("camera", "two", CAMERA)

    def lossy():
        return [one.message for one in lab.graph().problems if one.kind == "lossy"]

    until(lambda: "image" in detector.log(), "an image: both have found each other", PATIENCE)
    until(lambda: not lossy(), "a look", PATIENCE)
    words = ["ip", "netns", "exec", lab.pods["camera"].network, "iptables"]
    drop = ["OUTPUT", "-p", "udp", "-m", "length", "--length", "2000:", "-j", "DROP"]
    run(*words, "-A", *drop)
    (message,) = until(lossy, "loss", PATIENCE)
    assert re.fullmatch(
        r"/camera/image: \d+\.\d/s sent by camera, \d+\.\d/s taken by detector", message
    )
    run(*words, "-D", *drop)
    until(lambda: not lossy(), "end of the loss", PATIENCE)
    assert detector.process.poll() is None

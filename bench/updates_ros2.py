"""The programs and networks of `python -m bench.updates --ros 2`."""

from __future__ import annotations

from typing import Any

NETWORKS: dict[str, dict[str, Any]] = {
    "macvlan": {"mode": "macvlan", "interface": "eth0", "subnet": "10.197.0.0/16", "domain_id": 43},
    "peers": {"mode": "peers", "domain_id": 44},
    "discovery-server": {"mode": "discovery-server", "servers": 2, "domain_id": 45},
    "host": {"mode": "host", "domain_id": 46},
}
#: "VERSION NUMBER" in each message; the start is as late as that of a program with a model to load.
TALKER = """
import os, time
time.sleep(float(os.environ["LATE"]))
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String
VERSION, PERIOD = os.environ["VERSION"], 1 / int(os.environ["RATE"])
from rclpy.node import Node
class Talker(Node):
    number = 0
    def __init__(self):
        super().__init__("talker")
        self.publisher = self.create_publisher(String, "chatter", 100)
        self.create_timer(PERIOD, self.say)
    def say(self):
        self.publisher.publish(String(data="%s %d" % (VERSION, self.number)))
        self.number += 1
rclpy.init()
try:
    rclpy.spin(Talker())
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
LISTENER = """
import time, rclpy
from std_msgs.msg import String
def hear(message):
    print("heard %.4f %s" % (time.time(), message.data))
rclpy.init()
node = rclpy.create_node("listener")
node.create_subscription(String, "chatter", hear, 100)
rclpy.spin(node)
"""


def describe(network: str) -> tuple[str, dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the distribution, the talker, the listener, and more of the job's options."""
    talker = {"args": ["python3", "-c", TALKER]}
    listener = {"args": ["python3", "-c", LISTENER]}
    return "jazzy", talker, listener, {"network": NETWORKS[network]}

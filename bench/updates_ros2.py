"""The programs of `python -m bench.updates --ros 2`: plain nodes; for HandOver a lifecycle node."""

from __future__ import annotations

from typing import Any

#: Macvlan, so multicast of the two machines reaches each other as on one Ethernet.
NETWORK = {"mode": "macvlan", "interface": "eth0", "subnet": "10.197.0.0/16", "domain_id": 43}
#: "VERSION NUMBER" in each message; the start is as late as that of a program with a model to load.
HEAD = """
import os, time
time.sleep(float(os.environ["LATE"]))
import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String
VERSION, PERIOD = os.environ["VERSION"], 1 / int(os.environ["RATE"])
"""
PLAIN = """
from rclpy.node import Node
class Talker(Node):
    number = 0
    def __init__(self):
        super().__init__("talker")
        self.publisher = self.create_publisher(String, "chatter", 100)
        self.create_timer(PERIOD, self.say)
"""
LIFECYCLE = """
from rclpy.lifecycle import LifecycleNode
class Talker(LifecycleNode):
    number = 0
    def __init__(self):
        super().__init__("talker")
    def on_configure(self, state):
        self.publisher = self.create_lifecycle_publisher(String, "chatter", 100)
        return super().on_configure(state)
    def on_activate(self, state):
        self.timer = self.create_timer(PERIOD, self.say)
        return super().on_activate(state)
    def on_deactivate(self, state):
        self.destroy_timer(self.timer)
        return super().on_deactivate(state)
"""
TAIL = """
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


def describe(strategy: str) -> tuple[str, dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return the distribution, the talker, the listener, and more of the job's options."""
    text = HEAD + (LIFECYCLE if strategy == "HandOver" else PLAIN) + TAIL
    talker = {"args": ["python3", "-c", text]}
    return "jazzy", talker, {"args": ["python3", "-c", LISTENER]}, {"network": NETWORK}

"""Talks, answers, reaches goals and counts; prints each number that it handles, for judge.py.

Environment: VERSION such as v1; RATE of /chatter in Hz; LATE, seconds until it starts.
"""

import os
import time
from contextlib import suppress

time.sleep(float(os.environ.get("LATE", "0")))

import rclpy  # noqa: E402
from rcl_interfaces.msg import ParameterValue  # noqa: E402
from rcl_interfaces.srv import GetParameters  # noqa: E402
from rclpy._rclpy_pybind11 import RCLError  # noqa: E402
from rclpy.action import ActionServer  # noqa: E402
from rclpy.callback_groups import ReentrantCallbackGroup  # noqa: E402
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from std_msgs.msg import Int64, String  # noqa: E402
from test_msgs.action import Fibonacci  # noqa: E402

VERSION = os.environ["VERSION"]
PERIOD = 1 / float(os.environ.get("RATE", "20"))


def report(*words: object) -> None:
    """Print what was handled, with the time and the version; a line is whole among threads."""
    os.write(1, " ".join(map(str, [f"{time.time():.4f}", VERSION, *words, "\n"])).encode())


class Worker(Node):
    def __init__(self) -> None:
        super().__init__("worker")
        self.number = 0
        self.chatter = self.create_publisher(String, "chatter", 1000)
        self.create_timer(PERIOD, self.say)
        self.create_service(GetParameters, "work", self.answer)
        self.create_subscription(Int64, "counter", lambda m: report("count", m.data), 1000)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.map = self.create_publisher(String, "map", latched)
        self.map.publish(String(data=VERSION))
        more = ReentrantCallbackGroup()  # a goal takes its time, and the others do not wait for it
        ActionServer(self, Fibonacci, "reach", self.reach, callback_group=more)

    def say(self) -> None:
        self.chatter.publish(String(data=f"{VERSION} {self.number}"))
        self.number += 1

    def answer(self, request, response):
        report("call", request.names[0])
        response.values = [ParameterValue(string_value=VERSION)]
        return response

    def reach(self, goal):
        """Take as long as the goal says: its order is its number * 1000 + tenths of a second."""
        number, tenths = divmod(goal.request.order, 1000)
        report("begin", number)
        for step in range(tenths // 5):
            time.sleep(0.5)
            goal.publish_feedback(Fibonacci.Feedback(sequence=[number, step]))
        goal.succeed()
        report("end", number)
        return Fibonacci.Result(sequence=[number, int(VERSION[1:])])


rclpy.init()
# RCLError: its threads were about to do something when it was asked to end.
with suppress(KeyboardInterrupt, ExternalShutdownException, RCLError):
    rclpy.spin(Worker(), MultiThreadedExecutor(4))

"""Calls the worker without pause, sends it goals and numbers, and listens; prints for judge.py.

Environment: HERTZ of the calls and of the counter; GOAL, seconds of a goal, 0 for none; HEAR, the
names of talkers, with commas between them.
"""

import os
import time
from contextlib import suppress
from functools import partial

import rclpy
from action_msgs.msg import GoalStatus
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64, String
from test_msgs.action import Fibonacci

PERIOD = 1 / float(os.environ.get("HERTZ", "100"))
GOAL = float(os.environ.get("GOAL", "2"))
#: Seconds until a call counts as lost; a goal has these beside its own time.
CALL, PATIENCE = 20.0, 60.0


def report(*words: object) -> None:
    """Print what happened, with the time."""
    print(f"{time.time():.4f}", *words, flush=True)  # noqa: T201


class Caller(Node):
    def __init__(self) -> None:
        super().__init__("caller")
        self.call, self.goal, self.number = (0, 0.0, None), (0, 0.0), 0
        self.create_subscription(String, "chatter", lambda m: report("chat", m.data), 1000)
        for name in filter(None, os.environ.get("HEAR", "").split(",")):
            self.hear(name)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(String, "map", lambda m: report("map", m.data), latched)
        self.counter = self.create_publisher(Int64, "counter", 1000)
        self.client = self.create_client(GetParameters, "work")
        self.action = ActionClient(self, Fibonacci, "reach")
        self.create_timer(PERIOD, self.ask)
        self.create_timer(PERIOD, self.count)
        if GOAL:
            self.create_timer(0.05, self.aim)

    def hear(self, name: str) -> None:
        """Listen to a talker, too."""
        show = partial(self.show, f"chat/{name}")
        self.create_subscription(String, f"{name}/chatter", show, 1000)

    def show(self, kind: str, message) -> None:
        report(kind, message.data)

    def count(self) -> None:
        self.number += 1
        self.counter.publish(Int64(data=self.number))

    def ask(self) -> None:
        """Call again as soon as the last call was answered, or is lost."""
        number, since, open_call = self.call
        if open_call is not None and not open_call.done():
            if time.monotonic() < since + CALL:
                return
            self.client.remove_pending_request(open_call)
            report("call", number, "lost")
        if not self.client.service_is_ready():
            self.call = (number, 0.0, None)
            return
        number, since = number + 1, time.monotonic()
        future = self.client.call_async(GetParameters.Request(names=[str(number)]))
        self.call = (number, since, future)

        def is_answered(done) -> None:
            if not done.cancelled() and done.result() is not None:
                took = (time.monotonic() - since) * 1000
                report("call", number, done.result().values[0].string_value, f"{took:.1f}")

        future.add_done_callback(is_answered)

    def aim(self) -> None:
        """Send the next goal as soon as the last one is over, or is lost."""
        number, since = self.goal
        if since:
            if time.monotonic() > since + GOAL + PATIENCE:
                report("goal", number, "lost")
                self.goal = (number, 0.0)
            return
        if not self.action.server_is_ready():
            return
        number += 1
        self.goal = (number, time.monotonic())
        report("goal", number, "sent")
        order = number * 1000 + round(GOAL * 10)
        sent = self.action.send_goal_async(
            Fibonacci.Goal(order=order), lambda m: report("goal", number, "feedback")
        )
        sent.add_done_callback(lambda done: self.was_taken(number, done.result()))

    def was_taken(self, number: int, goal) -> None:
        report("goal", number, "accepted" if goal.accepted else "refused")
        if goal.accepted:
            goal.get_result_async().add_done_callback(lambda d: self.is_over(number, d.result()))
        else:
            self.goal = (number, 0.0)

    def is_over(self, number: int, answer) -> None:
        succeeded = answer.status == GoalStatus.STATUS_SUCCEEDED
        report("goal", number, "succeeded" if succeeded else f"status-{answer.status}")
        if self.goal[0] == number:
            self.goal = (number, 0.0)


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Caller())

"""A lifecycle node that talks while it is active, as talker.py does; it cannot be configured twice.

Environment: VERSION such as v1; RATE in Hz.
"""

import os
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from std_msgs.msg import String


class Managed(LifecycleNode):
    number = 0

    def on_configure(self, state) -> TransitionCallbackReturn:
        self.publisher = self.create_lifecycle_publisher(String, "~/chatter", 100)
        return super().on_configure(state)

    def on_activate(self, state) -> TransitionCallbackReturn:
        self.create_timer(1 / float(os.environ.get("RATE", "20")), self.say)
        return super().on_activate(state)

    def say(self) -> None:
        self.publisher.publish(String(data=f"{os.environ['VERSION']} {self.number}"))
        self.number += 1


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Managed("managed"))

"""Says its version and a number; the smallest node that an update may interrupt.

Environment: VERSION such as v1; RATE in Hz; LATE, seconds until it starts.
"""

import os
import time
from contextlib import suppress

time.sleep(float(os.environ.get("LATE", "0")))

import rclpy  # noqa: E402
from rclpy.executors import ExternalShutdownException  # noqa: E402
from rclpy.node import Node  # noqa: E402
from std_msgs.msg import String  # noqa: E402


class Talker(Node):
    def __init__(self) -> None:
        super().__init__("talker")
        self.number = 0
        self.publisher = self.create_publisher(String, "~/chatter", 100)
        self.create_timer(1 / float(os.environ.get("RATE", "20")), self.say)

    def say(self) -> None:
        self.publisher.publish(String(data=f"{os.environ['VERSION']} {self.number}"))
        self.number += 1


rclpy.init()
with suppress(KeyboardInterrupt, ExternalShutdownException):
    rclpy.spin(Talker())

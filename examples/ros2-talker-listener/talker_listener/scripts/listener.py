#!/usr/bin/env python3
"""Log each greeting that arrives on /chatter: `I heard hello world from NAME: NONCE N`."""

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String


class Listener(Node):
    def __init__(self):
        super().__init__("listener")
        self.create_subscription(String, "chatter", self.heard, 10)

    def heard(self, message):
        self.get_logger().info(f"I heard {message.data}")


def main():
    rclpy.init()
    try:
        rclpy.spin(Listener())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # asked to stop
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

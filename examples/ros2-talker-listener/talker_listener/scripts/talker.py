#!/usr/bin/env python3
"""Publish numbered greetings on /chatter: `hello world from NAME: NONCE N`.

NAME is the node's own; N counts up by one with each message. NONCE is what the node's parameter
`nonce` holds at that moment, "none" at first: if you set it and it arrives, the message was made
after that. Parameters: nonce, and rate, messages per second (default 2).
Environment: VERSION, printed in the log.
"""

import os

import rclpy
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String


class Talker(Node):
    def __init__(self):
        super().__init__("talker")
        self.declare_parameter("nonce", "none")
        rate = self.declare_parameter("rate", 2.0).value
        self.number = 0
        self.publisher = self.create_publisher(String, "chatter", 10)
        self.create_timer(1.0 / rate, self.greet)
        self.get_logger().info(f"talker version {os.environ.get('VERSION', 'unknown')}")

    def greet(self):
        self.number += 1
        nonce = self.get_parameter("nonce").value
        message = f"hello world from {self.get_name()}: {nonce} {self.number}"
        self.get_logger().info(message)
        self.publisher.publish(String(data=message))


def main():
    rclpy.init()
    try:
        rclpy.spin(Talker())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass  # asked to stop
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()

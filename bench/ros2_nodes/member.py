#!/usr/bin/env python3
"""A node without work; with MEMBERS, new participants join, and it prints how long that takes.

A new participant has a subscription. Data flows when it has discovered the publishers of all
MEMBERS; the graph is complete when it has the names of their nodes, which ROS 2 sends in messages
of its own. Printed: one line of JSON, `{"joins": [[seconds, seconds], ...]}`, null for what took
longer than PATIENCE.
"""

import json
import os
import sys
import threading
import time

import rclpy
from rclpy.context import Context
from std_msgs.msg import Empty

JOINS, PATIENCE = int(os.environ.get("JOINS", "15")), 30.0


def join(number, members):
    """Return the seconds until all publishers, and all nodes, are discovered; None: too long."""
    context = Context()
    started = time.monotonic()
    rclpy.init(context=context)
    node = rclpy.create_node(f"newcomer_{number}", context=context)
    node.create_subscription(Empty, "here", lambda _: None, 1)
    matched = named = None
    while time.monotonic() - started < PATIENCE and None in (matched, named):
        past = time.monotonic() - started
        if matched is None and node.count_publishers("here") >= members:
            matched = past
        names = {name for name in node.get_node_names() if not name.startswith("newcomer")}
        if named is None and len(names) >= members:
            named = past
        time.sleep(0.005)
    node.destroy_node()
    context.shutdown()
    return matched, named


def measure(members):
    """Let new participants join one after the other, after all members discovered each other."""
    while None in join(0, members):
        time.sleep(1.0)
    joins = []
    for number in range(1, JOINS + 1):
        time.sleep(1.0)
        joins.append(join(number, members))
    sys.stdout.write(json.dumps({"joins": joins}) + "\n")
    sys.stdout.flush()


def main():
    """Wait for the signal to end."""
    rclpy.init()
    node = rclpy.create_node("member")
    node.create_publisher(Empty, "here", 1)
    if members := os.environ.get("MEMBERS"):
        threading.Thread(target=measure, args=(int(members),), daemon=True).start()
    rclpy.spin(node)


if __name__ == "__main__":
    main()

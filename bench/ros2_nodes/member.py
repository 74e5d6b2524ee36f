#!/usr/bin/env python3
"""A node that does nothing but be there; with MEMBERS it has newcomers join, and tells how long.

A newcomer is a participant of its own. It has joined when it knows the nodes of all MEMBERS.
Printed: one line of JSON, `{"joins": [seconds, ...]}`.
"""

import json
import os
import sys
import threading
import time

import rclpy
from rclpy.context import Context

JOINS, PATIENCE = 7, 60.0


def join(number, members):
    """Return the seconds from nothing to all nodes known, None where it took too long."""
    context = Context()
    started = time.monotonic()
    rclpy.init(context=context)
    node = rclpy.create_node(f"newcomer_{number}", context=context)
    took = None
    while time.monotonic() - started < PATIENCE:
        known = {name for name in node.get_node_names() if not name.startswith("newcomer")}
        if len(known) >= members:
            took = time.monotonic() - started
            break
        time.sleep(0.002)
    node.destroy_node()
    context.shutdown()
    return took


def measure(members):
    """Let newcomers join one after the other, once all members know each other."""
    if join(0, members) is None:
        sys.stdout.write(json.dumps({"joins": []}) + "\n")
        return
    joins = []
    for number in range(1, JOINS + 1):
        time.sleep(1.0)
        joins.append(join(number, members))
    sys.stdout.write(json.dumps({"joins": joins}) + "\n")
    sys.stdout.flush()


def main():
    """Be there until asked to stop."""
    rclpy.init()
    node = rclpy.create_node("member")
    if members := os.environ.get("MEMBERS"):
        threading.Thread(target=measure, args=(int(members),), daemon=True).start()
    rclpy.spin(node)


if __name__ == "__main__":
    main()

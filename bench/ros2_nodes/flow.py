#!/usr/bin/env python3
"""source|sink: small messages at 100 Hz, then of 1 MB at 30 Hz; their latency and loss.

All pods of the machine of namespaces have the same clock, so a message contains the time when it
was sent. The sink prints one line of JSON for each size: `{"size", "sent", "received",
"latency": [median, 99 %] in ms}`.
"""

import array
import json
import statistics
import struct
import sys
import time

import rclpy
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

HEAD = struct.Struct("<IIQQ")  # size, how many there will be, number, when
PHASES = ((100, 100, 500), (1_000_000, 30, 240))  # size, Hz, how many
QUALITY = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=10, reliability=ReliabilityPolicy.BEST_EFFORT
)


def source(node):
    """Wait for the sink, then send both phases, as long as it exists."""
    publisher = node.create_publisher(UInt8MultiArray, "flow", QUALITY)
    while publisher.get_subscription_count() == 0:
        rclpy.spin_once(node, timeout_sec=0.1)
    time.sleep(2.0)
    for size, rate, count in PHASES:
        body = array.array("B", bytes(size))
        message = UInt8MultiArray(data=body)
        due = time.monotonic()
        for number in range(count):
            HEAD.pack_into(body, 0, size, count, number, time.monotonic_ns())
            message.data = body
            publisher.publish(message)
            due += 1 / rate
            time.sleep(max(0.0, due - time.monotonic()))
        time.sleep(2.0)
    rclpy.spin(node)


def sink(node):
    """Receive; a phase is over when nothing has arrived for a second."""
    late, counts, last = {}, {}, [0.0]

    def take(message):
        now = time.monotonic_ns()
        size, count, _, sent = HEAD.unpack_from(message.data)
        counts[size] = count
        late.setdefault(size, []).append((now - sent) / 1e6)
        last[0] = time.monotonic()

    node.create_subscription(UInt8MultiArray, "flow", take, QUALITY)
    printed = set()
    while True:
        rclpy.spin_once(node, timeout_sec=0.1)
        if last[0] and time.monotonic() - last[0] > 1.0:
            for size in sorted(set(late) - printed):
                print_phase(size, counts[size], late[size])
                printed.add(size)


def print_phase(size, count, late):
    """Print a phase's figures."""
    ordered = sorted(late)
    latency = [statistics.median(ordered), ordered[int(len(ordered) * 0.99)]]
    figures = {"size": size, "sent": count, "received": len(late), "latency": latency}
    sys.stdout.write(json.dumps(figures) + "\n")
    sys.stdout.flush()


def main():
    """Run the source or the sink."""
    rclpy.init()
    role = sys.argv[1]
    {"source": source, "sink": sink}[role](rclpy.create_node(role))


if __name__ == "__main__":
    main()

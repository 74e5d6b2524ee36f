"""One node of bench.images; runs in an environment with rclpy.

usage: image_node.py publish|subscribe SIZE SECONDS RELIABILITY PARTNERS

Messages are passed as bytes in the form of the wire, so that Python's own conversion of large
arrays is not measured.
"""

from __future__ import annotations

import json
import os
import resource
import struct
import sys
import time
from typing import Any

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import UInt8MultiArray

RATE, TOPIC, STAMP = 30, "images", slice(16, 24)


def cpu() -> float:
    """Return seconds of the processor so far."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def publish(node: Any, qos: QoSProfile, size: int, seconds: float, partners: int) -> dict[str, Any]:
    """Publish for some seconds, once all partners are matched."""
    publisher = node.create_publisher(UInt8MultiArray, TOPIC, qos)
    head = b"\0\1\0\0" + struct.pack("<III", 0, 0, size)
    body = bytes(size - 8)
    end = time.monotonic() + 20
    while publisher.get_subscription_count() < partners and time.monotonic() < end:
        time.sleep(0.05)
    time.sleep(1)
    start, before, sent = time.monotonic(), cpu(), 0
    while time.monotonic() - start < seconds:
        publisher.publish(b"".join((head, struct.pack("<d", time.time()), body)))
        sent += 1
        time.sleep(max(0.0, start + sent / RATE - time.monotonic()))
    return {"sent": sent, "cpu": cpu() - before, "partners": publisher.get_subscription_count()}


def subscribe(node: Any, qos: QoSProfile, seconds: float) -> dict[str, Any]:
    """Receive until nothing has come for some seconds."""
    delays: list[float] = []
    last = time.monotonic() + 20
    before = cpu()

    def take(message: bytes) -> None:
        nonlocal last, before
        if not delays:
            before = cpu()
        delays.append(time.time() - struct.unpack("<d", message[STAMP])[0])
        last = time.monotonic()

    node.create_subscription(UInt8MultiArray, TOPIC, take, qos, raw=True)
    while time.monotonic() < last + seconds:
        rclpy.spin_once(node, timeout_sec=0.1)
    return {"delays": delays, "cpu": cpu() - before}


def main(role: str, size: str, seconds: str, reliability: str, partners: str) -> None:
    """Print as JSON what was sent or received."""
    rclpy.init()
    node = rclpy.create_node(role)
    qos = QoSProfile(depth=5, reliability=ReliabilityPolicy[reliability])
    if role == "publish":
        found = publish(node, qos, int(size), float(seconds), int(partners))
    else:
        found = subscribe(node, qos, 4)
    print(json.dumps(found), flush=True)
    os._exit(0)  # some versions of ROS hang or crash while they end


if __name__ == "__main__":
    main(*sys.argv[1:])

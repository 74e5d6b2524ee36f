"""A hidden node that has discovered the graph."""

import os
import time
from contextlib import contextmanager

import rclpy
from failure import Failure
from rclpy.signals import SignalHandlerOptions

#: Seconds that what a command names has to appear, if --spin-time is less: on a busy machine the
#: discovery of a node that has long been running can take more than three.
PATIENCE = 10.0


@contextmanager
def session(options, *, wait=True):
    """Yield a node; with `wait`, after it had the time to discover all others."""
    # Without handlers of rclpy's own: its shutdown and ours would meet (jazzy: RCLError).
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    name = f"_ros2cli_{os.getpid()}"
    node = rclpy.create_node(name, start_parameter_services=False, enable_rosout=False)
    try:
        if wait:
            spin(node, lambda: False, options.spin_time)
        yield node
    finally:
        rclpy.shutdown()


def spin(node, done, seconds=None):
    """Spin until `done()`, for `seconds` at most; returns whether it is done."""
    end = None if seconds is None else time.monotonic() + seconds
    while not done():
        left = 0.1 if end is None else min(0.1, end - time.monotonic())
        if left <= 0:
            return False
        rclpy.spin_once(node, timeout_sec=left)
    return True


def appears(node, known, options):
    """Spin until what the command names is `known()`; returns whether it is."""
    return spin(node, known, max(options.spin_time, PATIENCE))


def full(name):
    """Return a name as the graph has it."""
    return name if name.startswith("/") else f"/{name}"


def hidden(name):
    """Whether a part of a name begins with an underscore."""
    return any(part.startswith("_") for part in name.split("/"))


def topic_type(node, topic, options):
    """Return the type of a topic that another node has.

    Raises:
        Failure: no node has it.
    """
    topic = full(topic)
    types = []

    def known():
        types[:] = dict(node.get_topic_names_and_types()).get(topic, [])
        return bool(types)

    if not appears(node, known, options):
        raise Failure(f"topic [{topic}] is not published and not subscribed; see `ros2 topic list`")
    return types[0]

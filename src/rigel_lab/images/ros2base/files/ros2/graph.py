"""What is in the graph: nodes, topics and their messages, parameters."""

import importlib
import os
import time
from contextlib import contextmanager

import rclpy
import yaml
from programs import Failure
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions

#: Seconds that what a command names has to appear, if --spin-time is less: on a busy machine the
#: discovery of a node that has long been running can take more than three.
PATIENCE = 10.0
#: Seconds that a node has for its answer.
ANSWER = 5.0
KINDS = {bool: "Boolean", int: "Integer", float: "Double", str: "String"}


@contextmanager
def session():
    """Yield a hidden node."""
    # Without handlers of rclpy's own: its shutdown and ours would meet (jazzy: RCLError).
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    name = f"_ros2cli_{os.getpid()}"
    try:
        yield rclpy.create_node(name, start_parameter_services=False, enable_rosout=False)
    finally:
        rclpy.shutdown()


def spin(node, seconds=None, done=lambda: False):
    """Spin until `done()`, for `seconds` at most; returns whether it is done."""
    end = None if seconds is None else time.monotonic() + seconds
    while not done():
        left = 0.1 if end is None else min(0.1, end - time.monotonic())
        if left <= 0:
            return False
        rclpy.spin_once(node, timeout_sec=left)
    return True


def list_nodes(options):
    with session() as node:
        spin(node, options.spin_time)
        found = node.get_node_names_and_namespaces()
    names = {f"{space.rstrip('/')}/{name}" for name, space in found}
    print("\n".join(sorted(name for name in names if "/_" not in name)))


def list_topics(options):
    with session() as node:
        spin(node, options.spin_time)
        found = node.get_topic_names_and_types()
    for name, kinds in sorted(found):
        if "/_" not in name:
            print(f"{name} [{', '.join(kinds)}]" if options.show_types else name)


def describe_topic(options):
    topic = full(options.topic)
    with session() as node:
        kind = find_type(node, topic, options)
        spin(node, options.spin_time)
        print(f"Type: {kind}")
        print(f"Publisher count: {node.count_publishers(topic)}")
        print(f"Subscription count: {node.count_subscribers(topic)}")


def echo(options):
    topic = full(options.topic)
    with session() as node:
        kind = options.type or find_type(node, topic, options)
        seen = []

        def show(message):
            seen.append(True)
            for name in filter(None, options.field.split(".")):
                message = getattr(message, name)
            found = to_plain(message)
            is_tree = isinstance(found, (dict, list))
            text = yaml.safe_dump(found, sort_keys=False) if is_tree else f"{found}\n"
            print(f"{text}---", flush=True)

        node.create_subscription(message_class(kind), topic, show, 10)
        spin(node, done=lambda: options.once and seen)


def publish(options):
    message = message_class(options.type)()
    for name, value in yaml.safe_load(options.values).items():
        setattr(message, name, value)
    with session() as node:
        publisher = node.create_publisher(type(message), options.topic, 10)
        while options.once and not spin(node, 1.0, lambda: publisher.get_subscription_count() > 0):
            print("Waiting for at least 1 matching subscription(s)...", flush=True)
        number = 0
        while not (options.once and number):
            number += 1
            print(f"publishing #{number}: {message}\n", flush=True)
            publisher.publish(message)
            spin(node, 0.1 if options.once else 1 / options.rate)


def get_parameter(options):
    name = full(options.node)
    with session() as node:
        client = AsyncParameterClient(node, name)
        if not appears(node, client.services_are_ready, options):
            raise Failure(f"Node not found: {name}")
        future = client.get_parameters([options.name])
        if not spin(node, ANSWER, future.done):
            raise Failure(f"{name} did not answer in {ANSWER:.0f} s")
        values = [parameter_value_to_python(one) for one in future.result().values]
    if values in ([], [None]):
        raise Failure(f"Parameter not set: {options.name}")
    print(f"{KINDS.get(type(values[0]), 'Array')} value is: {values[0]}")


def appears(node, known, options):
    """Spin until what the command names is `known()`; returns whether it is."""
    return spin(node, max(options.spin_time, PATIENCE), known)


def full(name):
    """Return a name as the graph has it."""
    return name if name.startswith("/") else f"/{name}"


def find_type(node, topic, options):
    """Return the type of a topic that another node has.

    Raises:
        Failure: no node has it.
    """
    if not appears(node, lambda: topic in dict(node.get_topic_names_and_types()), options):
        raise Failure(f"topic [{topic}] is not published and not subscribed; see `ros2 topic list`")
    return dict(node.get_topic_names_and_types())[topic][0]


def message_class(kind):
    """Return the class of `std_msgs/msg/String` or `std_msgs/String`."""
    package, *_, name = kind.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError):
        raise Failure(f"The message type '{kind}' is not in this image") from None


def to_plain(value):
    """Return a message or a part of one as plain data."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: to_plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, (list, tuple)):
        return [to_plain(one) for one in value]
    return value.tolist() if hasattr(value, "tolist") else value  # numpy's arrays and numbers

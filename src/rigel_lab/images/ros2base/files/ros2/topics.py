"""Receiving and publishing a topic."""

import statistics
import time
from itertools import pairwise

import yaml
from failure import Failure
from messages import fill, message_class, plain
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from session import full, session, spin, topic_type


def echo(options):
    with session(options, wait=False) as node:
        kind = options.type or topic_type(node, options.topic, options)
        seen = []

        def heard(message):
            seen.append(True)
            print(f"{_text(message, options.field)}---", flush=True)

        _subscribe(node, options.topic, kind, heard)
        spin(node, lambda: options.once and seen)


def hz(options):
    times = []
    with session(options, wait=False) as node:
        kind = topic_type(node, options.topic, options)
        _subscribe(node, options.topic, kind, lambda _: times.append(time.monotonic()))
        while True:
            before = len(times)
            spin(node, lambda: False, 1.0)
            del times[: -options.window - 1]
            if len(times) > 1 and len(times) != before:
                print(_rates(times), flush=True)
            elif len(times) == before:
                print("no new messages", flush=True)


def pub(options):
    message = fill(message_class(options.type)(), yaml.safe_load(options.values))
    times = 1 if options.once else options.times
    wanted = options.wait_matching_subscriptions
    wanted = (1 if times else 0) if wanted is None else wanted
    with session(options, wait=False) as node:
        publisher = node.create_publisher(type(message), options.topic, 10)
        while not spin(node, lambda: publisher.get_subscription_count() >= wanted, 1.0):
            print(f"Waiting for at least {wanted} matching subscription(s)...", flush=True)
        number = 0
        while not times or number < times:
            number += 1
            print(f"publishing #{number}: {message}\n", flush=True)
            publisher.publish(message)
            spin(node, lambda: False, 0.1 if number == times else 1 / options.rate)


def _subscribe(node, topic, kind, callback):
    """Subscribe with a QoS that the publishers can serve."""
    qos = QoSProfile(depth=10)
    offered = [end.qos_profile for end in node.get_publishers_info_by_topic(full(topic))]
    if any(o.reliability == ReliabilityPolicy.BEST_EFFORT for o in offered):
        qos.reliability = ReliabilityPolicy.BEST_EFFORT
    if offered and all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in offered):
        qos.durability = DurabilityPolicy.TRANSIENT_LOCAL
    node.create_subscription(message_class(kind), full(topic), callback, qos)


def _text(message, field):
    found = message
    for name in field.split(".") if field else ():
        if not hasattr(found, name):
            raise Failure(f"Invalid field '{field}': it has no '{name}'")
        found = getattr(found, name)
    found = plain(found)
    if not isinstance(found, (dict, list)):
        return f"{found}\n"
    return yaml.safe_dump(found, sort_keys=False, allow_unicode=True, width=10**6)


def _rates(times):
    gaps = [later - earlier for earlier, later in pairwise(times)]
    spread = statistics.pstdev(gaps)
    return (
        f"average rate: {1 / statistics.fmean(gaps):.3f}\n"
        f"\tmin: {min(gaps):.3f}s max: {max(gaps):.3f}s std dev: {spread:.5f}s window: {len(gaps)}"
    )

"""Prometheus' text format, and the meaning of each metric; independent of the values' sources."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import NamedTuple
from zlib import crc32

#: Characters of a label's value; the longest name of a topic in DDS has 255.
MOST_OF_A_LABEL = 255
CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Sample(NamedTuple):
    """One value of a metric that FAMILIES has."""

    name: str
    value: float
    labels: Mapping[str, str] = {}


#: Every metric in the order of the output: type and meaning; docs/ros-metrics.md has details.
FAMILIES: Mapping[str, tuple[str, str]] = {
    "ros_exporter_info": ("gauge", "The exporter itself; always 1."),
    "ros_exporter_collect_seconds": ("gauge", "Seconds that the last look at the graph took."),
    "ros_exporter_last_collect_timestamp_seconds": ("gauge", "When the last look ended."),
    "ros_exporter_failures_total": ("counter", "Looks and messages that could not be understood."),
    "ros_exporter_dropped": ("gauge", "Items that were dropped because a limit was reached."),
    "ros_master_up": ("gauge", "1: the ROS master answers."),
    "ros_master_start_time_seconds": ("gauge", "When this ROS master was first seen."),
    "ros_master_restarts_total": ("counter", "Times that another ROS master was found."),
    "ros_node_up": ("gauge", "1: registered or discovered, and answering."),
    "ros_node_registered": ("gauge", "1: registered at the ROS master, or discovered."),
    "ros_node_missing_registrations": (
        "gauge",
        "Topics of the node that are not registered at the ROS master.",
    ),
    "ros_node_restarts_total": (
        "counter",
        "Times that another process of the node was found in its pod.",
    ),
    "ros_node_turn_age_seconds": (
        "gauge",
        "Seconds since an executor of the node's process last looked for work; 0 while it waits.",
    ),
    "ros_topic_publishers": ("gauge", "Publishers of a topic."),
    "ros_topic_subscribers": ("gauge", "Subscribers of a topic, without this exporter."),
    "ros_node_topic_messages_total": ("counter", "Messages, as the node itself counts."),
    "ros_node_topic_bytes_total": ("counter", "Bytes of messages, as the node itself counts."),
    "ros_node_topic_partners": ("gauge", "Publishers or subscribers that it is connected to."),
    "ros_node_topic_refused_total": (
        "counter",
        "Calls that the middleware answered with an error.",
    ),
    "ros_node_topic_dropped_total": (
        "counter",
        "Messages that did not pass while the node waited to take over, or was replaced.",
    ),
    "ros_node_topic_longest_gap_seconds": (
        "gauge",
        "Longest time between two messages in the last minute, or since the last one.",
    ),
    "ros_node_topic_age_seconds": (
        "gauge",
        "Seconds from the publication of the last message to its taking.",
    ),
    "ros_topic_messages_total": (
        "counter",
        "Messages that the exporter received; in ROS 2, that nodes published.",
    ),
    "ros_topic_bytes_total": ("counter", "Bytes of the messages that the exporter received."),
    "ros_topic_last_message_timestamp_seconds": ("gauge", "When the last message was received."),
    "ros_topic_as_expected": (
        "gauge",
        "1: the topic is as the Rigelfile expects it; 0: it is not.",
    ),
    "ros_topic_header_age_seconds": (
        "gauge",
        "Age of the last message's header when the message was received.",
    ),
    "ros_diagnostics_level": ("gauge", "0 ok, 1 warning, 2 error, 3 stale."),
    "ros_clock_age_seconds": ("gauge", "Seconds since the last message on /clock."),
    "ros_tf_age_seconds": ("gauge", "Seconds since a transform's stamp."),
    "process_cpu_seconds_total": ("counter", "CPU time of the exporter."),
    "process_resident_memory_bytes": ("gauge", "Resident memory of the exporter."),
    "process_start_time_seconds": ("gauge", "When the exporter started."),
}


#: The labels of those that have some; docs/metrics.md is generated from both tables.
LABELS: Mapping[str, tuple[str, ...]] = {
    "ros_exporter_info": ("version", "ros", "middleware"),
    "ros_exporter_dropped": ("what",),
    "ros_node_up": ("ros_node", "workload"),
    "ros_node_registered": ("ros_node", "workload"),
    "ros_node_missing_registrations": ("ros_node", "workload"),
    "ros_node_restarts_total": ("ros_node", "workload"),
    "ros_node_turn_age_seconds": ("ros_node", "workload"),
    "ros_topic_publishers": ("topic", "type"),
    "ros_topic_subscribers": ("topic", "type"),
    "ros_node_topic_messages_total": ("ros_node", "topic", "direction"),
    "ros_node_topic_bytes_total": ("ros_node", "topic", "direction"),
    "ros_node_topic_partners": ("ros_node", "topic", "direction"),
    "ros_node_topic_refused_total": ("ros_node", "topic", "direction"),
    "ros_node_topic_dropped_total": ("ros_node", "topic", "direction"),
    "ros_node_topic_longest_gap_seconds": ("ros_node", "topic", "direction"),
    "ros_node_topic_age_seconds": ("ros_node", "topic"),
    "ros_topic_messages_total": ("topic",),
    "ros_topic_bytes_total": ("topic",),
    "ros_topic_last_message_timestamp_seconds": ("topic",),
    "ros_topic_as_expected": ("topic", "expectation"),
    "ros_topic_header_age_seconds": ("topic",),
    "ros_diagnostics_level": ("name", "hardware_id"),
    "ros_tf_age_seconds": ("parent", "child"),
}


def text(samples: Iterable[Sample]) -> str:
    """Return the samples as Prometheus reads them, by family."""
    found: dict[str, list[str]] = {name: [] for name in FAMILIES}
    for sample in samples:
        found[sample.name].append(_line(sample))
    parts = []
    for name, lines in found.items():
        if lines:
            kind, meaning = FAMILIES[name]
            parts += [f"# HELP {name} {meaning}", f"# TYPE {name} {kind}", *lines]
    return "\n".join(parts) + "\n"


def _line(sample: Sample) -> str:
    labels = ",".join(f'{key}="{_escape(shorten(value))}"' for key, value in sample.labels.items())
    return f"{sample.name}{{{labels}}} {_number(sample.value)}"


def shorten(value: str) -> str:
    """Return a label's value, one above MOST_OF_A_LABEL cut off and marked by its checksum."""
    if len(value) <= MOST_OF_A_LABEL:
        return value
    mark = f"...{crc32(value.encode('utf-8', 'replace')):08x}"
    return value[: MOST_OF_A_LABEL - len(mark)] + mark


def _escape(value: str) -> str:
    return value.replace("\\", "\\\\").replace("\n", "\\n").replace('"', '\\"')


def _number(value: float) -> str:
    if math.isfinite(value):
        return str(int(value)) if value == int(value) else repr(float(value))
    return {math.inf: "+Inf", -math.inf: "-Inf"}.get(value, "NaN")

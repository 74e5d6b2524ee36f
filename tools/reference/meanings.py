"""What the rules record, and when an alert fires, in words.

docs/metrics.md and docs/alerts.md are generated from it. The rules themselves are files of
rigel_stack/boards. A rule without its words here fails a test.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs


@attrs.frozen
class Series:
    """A recorded series: its unit, its labels in the order of the rule, and what its value is."""

    unit: str
    labels: tuple[str, ...]
    meaning: str


_NODE = ("namespace", "application", "workload", "ros_node")

SERIES: Mapping[str, Series] = {
    "pod:rigel_identity:info": Series(
        "1",
        ("namespace", "pod", "node", *_NODE[1:]),
        "Which pod is which ROS node: join other series with it, by pod.",
    ),
    "workload:kube_deployment_metadata_generation:max": Series(
        "count", _NODE[:3], "Changes with each roll-out."
    ),
    "application:rigel_pods_starting:count": Series(
        "pods",
        _NODE[:2],
        "Pods that pull an image or mount a volume, for 15 minutes at most.",
    ),
    "ros_node:container_cpu_usage_seconds:rate2m": Series("cores", _NODE, "CPU of a ROS node."),
    "ros_node:container_memory_working_set_bytes:sum": Series(
        "bytes", _NODE, "Memory of a ROS node that the kernel would not give back under pressure."
    ),
    "ros_node:kube_pod_container_status_restarts:increase15m": Series(
        "count", _NODE, "Restarts of containers in 15 minutes, without those of a roll-out."
    ),
    "ros_node:ros_node_orphaned:info": Series(
        "1", _NODE, "A node that a restarted master has forgotten, while the master answers."
    ),
    "topic:ros_topic_messages:rate5m": Series(
        "messages/s", ("namespace", "application", "topic"), "Rate of a named topic."
    ),
    "topic:ros_topic_without_publisher:subscribers": Series(
        "count",
        ("namespace", "application", "topic"),
        "Subscribers of a topic that has no publisher.",
    ),
    "node:filesystem_used:ratio": Series(
        "0 to 1", ("node",), "The used part of a machine's fullest disk."
    ),
    "node:cpu_used:rate2m": Series("cores", ("node",), "CPU of a machine."),
    "node:memory_used_bytes:sum": Series("bytes", ("node",), "Used memory of a machine."),
}

CONDITIONS: Mapping[str, str] = {
    "RosNodeGone": (
        "`ros_node_up` of a node is 0, its pod's container runs, its master answers, and no"
        " restarted master has forgotten it"
    ),
    "RosTopicSilent": (
        "the last message of a named topic is more than 30 s old, the topic had at least 0.1"
        " messages/s at some time of the last day, and the application neither starts pods nor has"
        " forgotten nodes"
    ),
    "RosTopicNotAsExpected": (
        "one thing that `expect` describes of a topic is not so, and the application neither starts"
        " pods nor has forgotten nodes"
    ),
    "RosTopicWithoutPublisher": (
        "a topic has subscribers and no publisher, and the application starts no pods"
    ),
    "RosMasterGone": "nothing answers at the ROS master's address",
    "RosMasterRestarted": "at least one node runs that a restarted master has forgotten",
    "RosNodeCrashLooping": (
        "a node's containers have restarted at least twice in 15 minutes, and one was in"
        " CrashLoopBackOff in the last 6 minutes"
    ),
    "RosDiagnosticsError": "/diagnostics reports error or stale for a component",
    "RosExporterDown": (
        "the exporter's pod is not scraped, or its last look at the graph is more than 120 s old"
    ),
    "DiskNearlyFull": "a machine's fullest disk is more than 90 % full",
    "VolumeNearlyFull": "a claim is more than 90 % full",
    "LogsNotArriving": (
        "a collector reads lines and sends none, or a machine with pods of ours has no collector"
        " that is up, or Loki receives no line at all, or no pod of Loki is available"
    ),
}

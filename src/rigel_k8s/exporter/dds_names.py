"""Names as ROS 2 writes them on DDS, and back.

Why: ROS 2 puts a prefix before its topics and mangles its types (design.ros2.org, "Topic and
Service name mapping to DDS"); who reads metrics wants the names that `ros2 topic list` shows.
It must not know RTPS.
"""

from __future__ import annotations

#: Where rmw implementations tell which nodes a participant has.
NODES = "ros_discovery_info"

_TOPIC, _SERVICES = "rt/", ("rq/", "rr/", "rs/")
_INTERFACES = ("msg", "srv", "action")


def is_service(topic: str) -> bool:
    """Whether a topic carries the requests or replies of a service."""
    return topic.startswith(_SERVICES)


def topic_name(topic: str) -> str:
    """Return a topic's name in ROS, and its own name where it is none of ROS'."""
    return topic[2:] if topic.startswith(_TOPIC) else topic


def type_name(name: str) -> str:
    """Return a type's name in ROS (std_msgs/msg/String), and its own where it is none of ROS'."""
    parts = name.split("::")
    if len(parts) == 4 and parts[1] in _INTERFACES and parts[2] == "dds_":
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return name

"""Names as ROS 2 writes them on DDS, and back.

Why: ROS 2 puts a prefix before its topics and mangles its types (design.ros2.org, "Topic and
Service name mapping to DDS"); metrics have the names that `ros2 topic list` shows.
It must not depend on RTPS.
"""

from __future__ import annotations

#: The topic on which rmw implementations publish the nodes of a participant.
NODES = "ros_discovery_info"

_TOPIC, _SERVICES = "rt/", ("rq/", "rr/", "rs/")
_INTERFACES = ("msg", "srv", "action")


def is_service(topic: str) -> bool:
    """Whether a topic carries the requests or replies of a service."""
    return topic.startswith(_SERVICES)


def topic_name(topic: str) -> str:
    """Return a topic's name in ROS, or its DDS name if it is not a ROS topic."""
    return topic[2:] if topic.startswith(_TOPIC) else topic


def type_name(name: str) -> str:
    """Return a type's name in ROS (std_msgs/msg/String), or its DDS name if ROS does not use it."""
    parts = name.split("::")
    if len(parts) == 4 and parts[1] in _INTERFACES and parts[2] == "dds_":
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return name

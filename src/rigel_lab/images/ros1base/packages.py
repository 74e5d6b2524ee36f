"""Which Debian packages make a ROS 1; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, TypeAlias

#: `core` runs nodes; `devel` also compiles catkin workspaces in C++.
Variant: TypeAlias = Literal["core", "devel"]

#: Debian 12 is the last release that ships ROS 1.
SUITE = "bookworm"

REFERENCES: Mapping[Variant, str] = MappingProxyType(
    {
        "core": "localhost/rigel-k8s/ros:noetic",
        "devel": "localhost/rigel-k8s/ros:noetic-devel",
    }
)

_CORE = (
    "ca-certificates",
    "procps",
    "python-is-python3",
    "python3-rosgraph-msgs",
    "python3-roslaunch",
    "python3-rosmaster",
    "python3-rosmsg",
    "python3-rosnode",
    "python3-rosparam",
    "python3-rospy",
    "python3-rosservice",
    "python3-rostopic",
    "python3-std-msgs",
    "python3-std-srvs",
    "ros-rosgraph-msgs",
    "ros-std-msgs",
    "ros-std-srvs",
    "rosbash",
    "rosout",
    "rospack-tools",
    "topic-tools",
    # Without it apt takes usrmerge, which drags in 50 MB of Perl.
    "usr-is-merged",
)

_DEVEL = (
    "g++",
    "libroscpp-dev",
    "libstd-msgs-dev",
    "libstd-srvs-dev",
    "libtopic-tools-dev",
    "make",
    "ros-message-generation",
)

PACKAGES: Mapping[Variant, tuple[str, ...]] = MappingProxyType(
    {"core": _CORE, "devel": tuple(sorted((*_CORE, *_DEVEL)))}
)

#: ROS packages whose package.xml Debian ships with their headers only, and what it says they are.
#: Without that file rospack, rosmsg, rosrun and roslaunch do not find them.
UNDESCRIBED: Mapping[str, str] = MappingProxyType(
    {
        "roscpp": "The messages and services of the C++ client library",
        "rosgraph_msgs": "Messages about the computation graph",
        "std_msgs": "Standard messages",
        "std_srvs": "Standard services",
        "topic_tools": "Programs that relay, throttle and multiplex topics",
    }
)

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

#: The client libraries and command line tools, and what `ros:noetic` has beyond them: actions,
#: nodelets with their manager, bonds, and the messages of sensors. nav_msgs is in `devel` only:
#: Debian's Python package of it brings the C++ headers and a compiler, 220 MB.
_CORE = (
    "ca-certificates",
    "libactionlib1d",
    "libnodeletlib-tools",
    "procps",
    "python-is-python3",
    "python3-actionlib",
    "python3-bondpy",
    "python3-dynamic-reconfigure",
    "python3-geometry-msgs",
    "python3-nodelet",
    "python3-rosgraph-msgs",
    "python3-roslaunch",
    "python3-rosmaster",
    "python3-rosmsg",
    "python3-rosnode",
    "python3-rosparam",
    "python3-rospy",
    "python3-rosservice",
    "python3-rostopic",
    "python3-sensor-msgs",
    "python3-std-msgs",
    "python3-std-srvs",
    "ros-actionlib-msgs",
    "ros-geometry-msgs",
    "ros-rosgraph-msgs",
    "ros-sensor-msgs",
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
    "libactionlib-dev",
    "libdynamic-reconfigure-config-init-mutex-dev",
    "libgeometry-msgs-dev",
    "libnav-msgs-dev",
    "libnodelet-dev",
    "libnodeletlib-dev",
    "libroscpp-dev",
    "libsensor-msgs-dev",
    "libstd-msgs-dev",
    "libstd-srvs-dev",
    "libtopic-tools-dev",
    "make",
    "python3-nav-msgs",
    "ros-message-generation",
    "ros-nav-msgs",
)

PACKAGES: Mapping[Variant, tuple[str, ...]] = MappingProxyType(
    {"core": _CORE, "devel": tuple(sorted((*_CORE, *_DEVEL)))}
)

#: ROS packages whose package.xml Debian ships only with their headers, and its description.
#: Without that file rospack, rosmsg, rosrun and roslaunch do not find them.
UNDESCRIBED: Mapping[str, str] = MappingProxyType(
    {
        "actionlib": "Tasks with feedback that may be preempted",
        "actionlib_msgs": "Messages about the goals of actions",
        "bond": "Messages by which two nodes notice each other's end",
        "bondcpp": "Bonds between nodes for C++",
        "dynamic_reconfigure": "Parameters that change while a node runs",
        "geometry_msgs": "Messages about points, poses and velocities",
        "roscpp": "The messages and services of the C++ client library",
        "rosgraph_msgs": "Messages about the computation graph",
        "sensor_msgs": "Messages of cameras, lasers and other sensors",
        "std_msgs": "Standard messages",
        "std_srvs": "Standard services",
        "topic_tools": "Programs that relay, throttle and multiplex topics",
    }
)

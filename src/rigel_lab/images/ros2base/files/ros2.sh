#!/bin/sh
# A small ros2 by rigel-k8s, see share/rigel_ros2.
exec python3 /opt/ros/@DISTRO@/share/rigel_ros2 "$@"

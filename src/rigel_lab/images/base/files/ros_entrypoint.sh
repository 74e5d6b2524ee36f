#!/bin/bash
# The image's ENTRYPOINT: what the container runs, runs in the ROS environment.
set -e
source "/opt/ros/$ROS_DISTRO/setup.bash" --
exec "$@"

#!/bin/sh
# Runs a command in the ROS 1 environment, for callers that cannot source a file (roslaunch's ssh).
. /opt/ros/noetic/setup.sh
exec "$@"

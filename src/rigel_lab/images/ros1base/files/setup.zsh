# The ROS 1 environment for zsh.
. /opt/ros/noetic/setup.sh

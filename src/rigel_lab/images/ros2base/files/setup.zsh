# The ROS 2 environment for zsh.
. /opt/ros/@DISTRO@/setup.sh

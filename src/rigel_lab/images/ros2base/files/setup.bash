# The ROS 2 environment for bash.
. /opt/ros/@DISTRO@/setup.sh

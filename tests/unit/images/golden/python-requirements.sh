set -e
source /opt/ros/noetic/setup.bash
export ROS_PACKAGE_PATH="/home/rigeluser/ros_workspace/src:$ROS_PACKAGE_PATH"
cd /home/rigeluser/ros_workspace/src/demo
# The command takes this shell's place, so that signals reach it.
exec "$@"

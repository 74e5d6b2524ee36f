set -e
source /opt/ros/noetic/setup.bash
source /root/ros_workspace/devel/setup.bash
cd /root/ros_workspace
# The command takes this shell's place, so that signals reach it.
exec "$@"

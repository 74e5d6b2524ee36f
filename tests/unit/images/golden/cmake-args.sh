set -e
source /opt/ros/noetic/setup.bash
source /home/rigeluser/ros_workspace/devel/setup.bash
cd /home/rigeluser/ros_workspace
# The command takes this shell's place, so that signals reach it.
exec "$@"

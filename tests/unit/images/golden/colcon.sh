set -e
source /opt/ros/humble/setup.bash
source /home/rigeluser/ros_workspace/install/setup.bash
cd /home/rigeluser/ros_workspace
# The command takes this shell's place, so that signals reach it.
exec "$@"

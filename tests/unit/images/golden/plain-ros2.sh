set -e
source /opt/ros/humble/setup.bash
cd /home/rigeluser/ros_workspace/src/demo
# The command takes this shell's place, so that signals reach it.
exec "$@"

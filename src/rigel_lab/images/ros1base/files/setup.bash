# The ROS 1 environment and the shell's own ROS commands (roscd, rosls) for bash.
. /opt/ros/noetic/setup.sh
if [ -r /usr/share/bash-completion/completions/rosbash ]; then
  . /usr/share/bash-completion/completions/rosbash
fi

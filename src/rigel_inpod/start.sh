#!/bin/sh
# The start of a container whose arguments or parameters only its image can complete: finds a Python
# and hands over to start.py, which becomes the program.
#
# Why: in ROS 1 parameters are read and set by the modules of rosparam, so it must be the Python of that.
# Contract: `start.sh ros1|ros2 ...` has the arguments of start.py. 3 if the image has no Python.
# Needs sh.

folder=${0%/*}
. "$folder/python.sh"
program=
if [ "$1" = ros1 ]; then program=rosparam; fi
become_python "$program" start.py "$@"
echo "rigel: this image has no Python, so its arguments and parameters cannot be completed" >&2
exit 3

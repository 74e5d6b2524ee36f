#!/bin/sh
# The start of a container whose arguments or parameters only its image can complete: finds a Python
# and hands over to start.py, which becomes the program.
#
# Why: in ROS 1 parameters are read and set by the modules of rosparam, so this must be the Python that the
# image's rosparam names; images of different ages have python3, python or python2.
# Contract: `start.sh ros1|ros2 ...` has the arguments of start.py. 3 if the image has no Python.
# Needs sh.

folder=${0%/*}
if [ "$1" = ros1 ] && found=$(command -v rosparam); then
  IFS= read -r first <"$found"
  case $first in
  '#!'*python*) exec ${first#??} -B "$folder/start.py" "$@" ;;
  esac
fi
for python in python3 python python2; do
  if command -v "$python" >/dev/null 2>&1; then
    exec "$python" -B "$folder/start.py" "$@"
  fi
done
echo "rigel: this image has no Python, so its arguments and parameters cannot be completed" >&2
exit 3

#!/bin/sh
# Runs record.py with the Python that has the image's rosbag.
#
# Why: in ROS 1 a bag is repaired by that module.
# Contract: `record.sh FOLDER ...` has the arguments and exit codes of record.py. 3 if the image has no Python.
# Needs sh.

folder=${0%/*}
. "$folder/python.sh"
become_python rosbag record.py "$@"
echo "[rigel-k8s] this image has no Python, so it cannot record: set \`record.image\`" >&2
exit 3

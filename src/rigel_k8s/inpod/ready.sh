#!/bin/sh
# The readiness probe's entry: finds a Python and hands over to ready.py.
#
# Why: images of different ages have python3, python or python2, and a probe that cannot run must
# say so instead of failing with the shell's words.
# Contract: the arguments and exit codes of ready.py; 3 where the image has no Python.
# -S -E -B: no site packages, no PYTHON* variables, no .pyc files; saves a third of the start.
for python in python3 python python2; do
  if command -v "$python" >/dev/null 2>&1; then
    exec "$python" -S -E -B "${0%/*}/ready.py" "$@"
  fi
done
echo "this image has no Python, so its ROS nodes cannot be probed:" \
  "set readiness.command or readiness.file for this node"
exit 3

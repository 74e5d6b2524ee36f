#!/bin/sh
# The probes' entry: finds a Python and hands over to ready.py, to dds_ready.py, or to rmw_ready.py.
#
# Why: images of different ages have python3, python or python2, and a probe that cannot run must
# report the reason instead of the shell's message.
# Contract: `ready.sh node|master ...` has the arguments and exit codes of ready.py, `ready.sh
# dds|zenoh ...` those of dds_ready.py, `ready.sh stuck ...` those of rmw_ready.py; 3 where the image has no Python (for DDS no Python 3).
# -S -E -B: no site packages, no PYTHON* variables, no .pyc files; saves a third of the start.
case $1 in
  dds | zenoh) script=dds_ready.py pythons=python3 needed='Python 3' what='its part in DDS cannot be probed' ;;
  stuck) script=rmw_ready.py pythons=python3 needed='Python 3' what='its executors cannot be probed' ;;
  *) script=ready.py pythons='python3 python python2' needed=Python what='its ROS nodes cannot be probed' ;;
esac
for python in $pythons; do
  if command -v "$python" >/dev/null 2>&1; then
    exec "$python" -S -E -B "${0%/*}/$script" "$@"
  fi
done
echo "this image has no $needed, so $what:" \
  "set readiness.command or readiness.file for this node"
exit 3

#!/bin/sh
# Runs a script of ours beside a node: `beside.sh SCRIPT [WORD...] -- PROGRAM [ARGUMENT...]`.
#
# Why: components are loaded into a container that runs already, and a lifecycle node makes its
# transitions only on request. Something in the pod has to do that while the node runs.
# Contract: PROGRAM becomes the process that this was. SCRIPT is a Python script of this directory; it
# ends when its work is done. RIGEL_K8S_EXEC keeps the probe from taking it for a node of the pod
# (container.py). Behind a discovery server it must discover every participant. Its words have no blanks.
# Needs sh. Without Python the probe reports that the script has not started.

folder=${0%/*}
words=
while [ "$1" != -- ]; do
  words="$words $1"
  shift
done
shift
(
  export RIGEL_K8S_EXEC=1
  if [ -n "${ROS_DISCOVERY_SERVER:-}" ]; then export ROS_SUPER_CLIENT=TRUE; fi
  for python in python3 python python2; do
    if command -v "$python" >/dev/null 2>&1; then
      # The words are split on purpose; the first one is the script.
      exec "$python" -B "$folder"/${words# } </dev/null
    fi
  done
  echo "[rigel-k8s] this image has no Python, which ${words# } needs"
) &
exec "$@"

#!/bin/sh
# Runs a lifecycle node that hands over: `lifecycle.sh PROGRAM ARGUMENT... --ros-args ...`.
#
# Why: two pods of one node offer the same services, so a request to /talker/change_state reaches
# both. So each pod's node gets a change_state under a name of its own, which lifecycle.py calls.
# Contract: the line must end in ROS arguments, to which two remappings are added; PROGRAM becomes the
# process that this was, and lifecycle.py runs beside it (beside.sh) until the node is active.
# RIGEL_K8S_LIFECYCLE is the node's full ROS name, RIGEL_K8S_POD the pod's name.
# Needs sh, date, tr; without Python 3 or rclpy the node is never activated, and the probe reports it.

token=t$(date +%s)_$(printf %s "${RIGEL_K8S_POD:-pod}" | tr -cs 'A-Za-z0-9' _)
own="~/_rigel_k8s/$token"
exec /bin/sh "${0%/*}/beside.sh" lifecycle.py take "$token" -- "$@" \
  -r "~/change_state:=$own/change_state" \
  -r "~/get_available_transitions:=$own/get_available_transitions"

#!/bin/sh
# Runs a command in the environment of the container's ROS node: `rigel exec NODE -- rostopic list`.
#
# Why: see rc.sh; only an interactive shell reads a start-up file, so a command needs this.
# Contract: exec.sh [COMMAND ARGUMENT...]; without a command an interactive shell, bash if the
# image has it. Ends with the command's exit code, 127 if the command does not exist.
. "${0%/*}/rc.sh"
if [ $# = 0 ]; then
  if command -v bash >/dev/null 2>&1; then exec bash; fi
  exec sh
fi
exec "$@"

#!/bin/sh
# Runs a command in the environment of the container's ROS node: `rigel exec NODE -- rostopic list`.
#
# Why: see rc.sh; a command that is no interactive shell reads no start-up file, so it needs this.
# Contract: exec.sh [COMMAND ARGUMENT...]; without a command an interactive shell, bash where the
# image has it. Ends with the command's exit code, 127 where there is no such command.
. "${0%/*}/rc.sh"
if [ $# = 0 ]; then
  if command -v bash >/dev/null 2>&1; then exec bash; fi
  exec sh
fi
exec "$@"

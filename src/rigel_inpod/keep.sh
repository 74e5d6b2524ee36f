#!/bin/sh
# Runs roscore behind the gate, and starts it again in the same container when it ends.
#
# Why: a container that ends makes its pod NotReady until Kubernetes has started it again, and ros-master's
# Service leaves out pods that are not ready. Yet the gate beside roscore still works: callers wait at it
# until roscore is back.
# Contract: keep.sh PROGRAM [ARGUMENT...]. A program that ends within 10 s of its start ends the container,
# with the program's exit code: Kubernetes starts it again, waits longer each time, and reports the cause. A
# program that ends when this process gets SIGINT or SIGTERM (stop.sh sends them) is not started again.
# Needs sh, sleep and /proc.

stopped=
trap 'stopped=yes' INT TERM

# Sets $seconds to the seconds that the machine is up.
clock() {
  IFS=' .' read -r seconds _ </proc/uptime
}

while :; do
  clock
  started=$seconds
  "$@"
  code=$?
  clock
  lived=$((seconds - started))
  if [ "$lived" -lt 10 ]; then exit "$code"; fi
  sleep 0.5 2>/dev/null || sleep 1 # stop.sh signals this process after the program has ended
  if [ -n "$stopped" ]; then exit "$code"; fi
  echo "${0##*/}: the program ended with exit code $code after $lived s; it is started again"
done

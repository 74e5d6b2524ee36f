#!/bin/sh
# Runs a ROS 2 program with the layer, and the keeper beside it: `rmw.sh PROGRAM [ARGUMENT...]`.
#
# Why: the layer (rigel_rmw) lets a program's processes wait and take over, and notes what they do.
# It must be loaded before ROS 2, and into these processes alone: a variable of the pod would load it
# into probes and shells too. So it is set here; children inherit it, those of a launch file too.
# Contract: RIGEL_RMW is this container's directory, on a volume of the pod. What an earlier start of the
# container has left there is removed, but not what the keeper knows. PROGRAM becomes the process that
# this was, whatever fails here. The library is tried with this image's own sh first: with a glibc older
# than 2.17 or a C library of 32 bits its programs might not start; with musl they do, and the library lets
# everything pass. If it fails, or there is no Python 3 for the keeper, the file `left-out` in RIGEL_RMW
# has the reason, for the probe; the library writes it where sh is static, or of another C library. With
# RIGEL_K8S_PEERS the processes begin in mode `wait`, and the keeper lets them work. It learns by
# RIGEL_RMW_BESIDE that a script beside the program (beside.sh) has work to do first. A keeper that fails is
# started again: without it they would wait for ever.
# Needs sh, uname, mkdir and rm.

folder=${0%/*}

# Whether the layer can be loaded; sets $library, or $reason.
load() {
  library=$folder/rmw-$(uname -m).so
  reason="there is no library for this machine ($(uname -m))"
  [ -r "$library" ] || return 1
  reason="its C library does not load ours, which needs glibc 2.17 or newer: set \`rmw_layer: false\`"
  answer=$(RIGEL_RMW_MODE=try LD_PRELOAD=$library /bin/sh -c : 2>&1) && [ -z "$answer" ]
}

# Runs the keeper until it ends by itself.
keep() {
  export RIGEL_K8S_EXEC=1
  case $line in *"$folder/beside.sh "*) export RIGEL_RMW_BESIDE=1 ;; esac
  until python3 -S -E -B "$folder/lean.py" "$folder/keeper.py" run </dev/null; do sleep 1; done
}

line=$*
(umask 0 && mkdir -p "$RIGEL_RMW") 2>/dev/null
rm -f "$RIGEL_RMW"/[0-9]* "$RIGEL_RMW"/control "$RIGEL_RMW"/left-out "$RIGEL_RMW"/progress "$RIGEL_RMW"/fit.json "$RIGEL_RMW"/rates
if [ ! -w "$RIGEL_RMW" ]; then
  echo "[rigel-k8s] cannot write $RIGEL_RMW, so the program runs without our library"
elif ! load; then
  echo "$reason" >"$RIGEL_RMW/left-out"
elif ! command -v python3 >/dev/null 2>&1; then
  echo "this image has no Python 3, which hand-over needs: set \`rmw_layer: false\`" >"$RIGEL_RMW/left-out"
else
  if [ -n "${RIGEL_K8S_PEERS:-}" ]; then export RIGEL_RMW_MODE=wait; fi
  keep &
  export LD_PRELOAD="$library${LD_PRELOAD:+:$LD_PRELOAD}"
fi
exec "$@"

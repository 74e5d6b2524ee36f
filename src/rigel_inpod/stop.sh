#!/bin/sh
# The preStop hook: ends the container's ROS nodes by SIGINT, on which they clean up.
#
# Why: Kubernetes sends SIGTERM to process 1 only. roscpp has no handler for it, a shell that is
# process 1 does not pass it on, and a killed node stays registered with the master. rospy, roscpp
# and roslaunch all unregister on SIGINT. Kubernetes sends SIGTERM as soon as this script returns, so
# it waits until the processes have ended. ROS 2's nodes leave DDS on SIGINT; it also helps `ros2
# launch`, which ignores SIGTERM, and `ros2 run`, which did not pass it on.
# Contract: stop.sh [SECONDS]; always 0. SIGINT is sent to every process of the container at once, with
# three exceptions: a roscore gets it after the nodes, so that they can unregister; what a roslaunch or
# a ros2 launch started does not get it, since the launcher stops it itself and would start it again
# otherwise; process 1 gets it last. All that still run after 1.5 s get SIGINT, and after half of SECONDS
# (default 8) SIGTERM. The script waits for all but process 1 and what that launched, unless process 1
# ignores SIGTERM (a shell, roscpp): then it continues in the background, since the end of process 1 ends
# this script too, and Kubernetes reports that as a failed hook.
# In a pod that hands over, its work is handed over first, if another pod waits for it. ROS 2: with
# RIGEL_K8S_PEERS by the keeper (keeper.py leave), which waits at most RIGEL_K8S_DRAIN seconds for goals
# of actions to end, in addition to SECONDS; the keeper itself is left alone until the container ends.
# ROS 1: with RIGEL_K8S_WORKLOAD by the gate (ready.py leave); the other pod has a quarter of SECONDS to
# become ready. Gate and master end the nodes then, and others get half a second to find the new ones.
# With RIGEL_K8S_DRAIN the pod may take that much longer to end, for goals alone: what ignores all signals
# is killed when the pod's own time is over, process 1 by the signal for which the layer made it exit.
# If nothing was handed over and RIGEL_K8S_TRANSITIONS is set, it holds a node and the transitions that it
# makes first (transitions.py stop), within half of SECONDS: with two nodes of its name, both would.
# Needs sh, sleep, tr and /proc.

here=${0%/*} handed=
if [ -n "$RIGEL_K8S_PEERS" ]; then
  if python3 -S -E -B "$here/keeper.py" leave --wait "${RIGEL_K8S_DRAIN:-300}"; then handed=1; fi
elif [ -n "$RIGEL_K8S_WORKLOAD" ]; then
  if /bin/sh "$here/ready.sh" leave --wait $((${1:-8} / 4)); then handed=1; fi
fi
if [ -n "$handed" ]; then
  sleep 0.5 2>/dev/null || sleep 1
elif [ -n "$RIGEL_K8S_TRANSITIONS" ]; then
  # The words are split on purpose: the node and its transitions.
  /bin/sh "$here/exec.sh" python3 -B "$here/transitions.py" stop $((${1:-8} / 2)) $RIGEL_K8S_TRANSITIONS
fi
bound=$((${1:-8} * 10)) tenth=0
own=$((${1:-28} + 2)) # the pod's own seconds: Kubernetes' 30, or what the hook's bound was made of
patience=15 # tenths of a second
classified=' ' keepers=' ' cores=' ' launches=' ' interrupted=' ' warned=' '

# Whether $2 is one of the words of $1, a list with blanks around each word.
has() {
  case $1 in *" $2 "*) return 0 ;; esac
  return 1
}

# Sets $state and $parent of process $1; fails if it has ended. Its name may hold any character.
look() {
  { IFS= read -r stat <"/proc/$1/stat"; } 2>/dev/null || return 1
  set -- ${stat##*) }
  state=$1 parent=$2
}

# Sets $cgroup of process $1: with hostPID the processes of other containers are visible.
group() {
  cgroup=
  { while IFS= read -r line; do cgroup="$cgroup$line|"; done <"/proc/$1/cgroup"; } 2>/dev/null
}

# Notes once whether process $1 is the keeper (or rmw.sh, which starts it again), a roscore, or launches
# others: `[python] PATH/roslaunch ...`, or `[python] PATH/ros2 launch ...`.
classify() {
  has "$classified" "$1" && return
  classified="$classified$1 "
  command=$({ tr '\0' ' ' <"/proc/$1/cmdline"; } 2>/dev/null)
  case $command in *" $here/keeper.py "* | *" $here/rmw.sh "*) keepers="$keepers$1 " && return ;; esac
  before=
  for word in $command; do
    case $before${word##*/} in
      python*) continue ;;
      ros2) before='ros2 ' && continue ;;
      roscore | roscore.py) cores="$cores$1 " ;;
      roslaunch | 'ros2 launch') launches="$launches$1 " ;;
    esac
    break
  done
}

# Whether an ancestor of process $1 is a roscore or a roslaunch.
launched() {
  parent=$1
  while look "$parent" && [ "$parent" -gt 0 ]; do
    has "$cores$launches" "$parent" && return 0
  done
  return 1
}

# Sets $all: the living processes to end, without this script, its ancestors and its children.
list() {
  all=
  for folder in /proc/[0-9]*; do
    pid=${folder#/proc/}
    has "$mine" "$pid" || ! look "$pid" || [ "$parent" = "$self" ] && continue
    case $state in Z | X) continue ;; esac
    group "$pid"
    [ "$cgroup" = "$home" ] || continue
    classify "$pid"
    has "$keepers" "$pid" && continue
    all="$all $pid"
  done
}

# Sends SIGINT to process $1, once, unless it is this script or started it.
interrupt() {
  has "$interrupted$mine" "$1" && return
  interrupted="$interrupted$1 "
  kill -INT "$1" 2>/dev/null
}

# One round at tenth $1: sends what is due, sets $first and $rest to the processes that still run.
round() {
  list
  first= rest=
  for pid in $all; do
    if [ "$pid" = 1 ]; then continue; fi
    if has "$cores" "$pid" || launched "$pid"; then rest="$rest $pid"; else first="$first $pid"; fi
  done
  for pid in $first; do interrupt "$pid"; done
  if [ -z "$first" ] || has "$launches" 1; then interrupt 1; fi
  if [ "$1" -ge "$patience" ] || [ -z "$first" ] && ! heeds 2; then
    for pid in $rest; do interrupt "$pid"; done
  fi
  [ "$1" -lt $((bound / 2)) ] && return
  for pid in $first $rest; do
    has "$warned" "$pid" && continue
    warned="$warned$pid "
    kill -TERM "$pid" 2>/dev/null
  done
}

# Whether signal number $1 has an effect on process 1: it handles it, or waits for it.
heeds() {
  masks=0
  while read -r key value; do
    case $key in SigBlk: | SigCgt:) masks=$((masks | 0x${value#????????})) ;; esac
  done </proc/1/status
  [ $((masks >> ($1 - 1) & 1)) = 1 ]
}

# Rounds until all but process 1 have ended, then process 1's turn.
work() {
  read -r self _ </proc/self/stat
  mine="$mine$self "
  while [ "$tenth" -lt "$bound" ]; do
    round "$tenth"
    [ -z "$first$rest" ] && break
    [ -z "$first" ] && has "$cores$launches" 1 && break # ends what it started automatically
    if sleep 0.1 2>/dev/null; then tenth=$((tenth + 1)); else sleep 1 && tenth=$((tenth + 10)); fi
  done
  interrupt 1
  if [ -n "$RIGEL_K8S_DRAIN" ]; then finish </dev/null >/dev/null 2>&1 & fi
}

# Ends what still runs when the pod's own time is over.
finish() {
  sleep $((own - tenth / 10))
  read -r self _ </proc/self/stat
  mine="$mine$self "
  kill -64 1 2>/dev/null
  list
  for pid in $all; do kill -KILL "$pid" 2>/dev/null; done
}

mine=" $$ " parent=$$
while look "$parent" && [ "$parent" -gt 0 ]; do mine="$mine$parent "; done
group $$
home=$cgroup
if heeds 15; then
  work
else
  work </dev/null >/dev/null 2>&1 &
fi
exit 0

#!/bin/sh
# Runs a node's program and starts it again on request: `dev.sh FIFO PROGRAM [ARGUMENT...]` (`rigel dev`).
#
# Why: a changed file takes effect when the program starts again; a container that ends loses the file.
# Contract: the line `restart` in FIFO, which is made here, ends the program by SIGINT, kills what still runs
# after 5 s, and starts it again. The first start waits for such a request, at most 30 s; a program that has
# ended waits for the next one. SIGTERM or SIGINT ends it, then this process. To it belongs what came after
# this process in its session: an exec has its own. A shell's background processes ignore SIGINT; Python undoes
# that. Needs sh, mkfifo, mv, rm, sleep, tr and /proc.

requests=$1 number=0
shift

# Sets $found to the processes of this session that are not in $mine.
list() {
  found=
  for folder in /proc/[0-9]*; do
    { IFS= read -r stat <"$folder/stat"; } 2>/dev/null || continue
    set -- ${stat##*) } # state, parent, group, session
    case "$1$mine" in Z* | X* | *" ${folder#/proc/} "*) continue ;; esac
    if [ "$4" = "$session" ]; then found="$found ${folder#/proc/}"; fi
  done
}

# Ends the program, each process by SIGINT, or by SIGTERM if it ignores that.
stop() {
  list
  for pid in $found; do
    case $(tr -d '\n\t' <"/proc/$pid/status") in *SigIgn:*[2367abef]SigCgt:*) kill -TERM "$pid" ;; *) kill -INT "$pid" ;; esac
  done 2>/dev/null
  tenth=0
  while [ -n "$found" ] && [ "$tenth" -lt 70 ]; do
    if sleep 0.1 2>/dev/null; then tenth=$((tenth + 1)); else sleep 1 && tenth=$((tenth + 10)); fi
    if [ "$tenth" -ge 50 ]; then kill -KILL $found 2>/dev/null; fi
    list
  done
}

become() {
  python=$(command -v python3 || command -v python) || exec "$@"
  exec "$python" -S -E -c 'import os, sys, signal as s
for n in (s.SIGINT, s.SIGQUIT, s.SIGPIPE, s.SIGXFSZ): s.signal(n, s.SIG_DFL)
os.execvp(sys.argv[1], sys.argv[1:])' "$@"
}

start() {
  number=$((number + 1))
  { (become "$@" 3<&-) && code=0 || code=$?; echo "ended $number $code" >&3; } &
  mine="$before $! "
}

# It has its name once it is open: what is written before that would be lost.
rm -f "$requests" "$requests.new"
mkfifo "$requests.new" && exec 3<>"$requests.new" && mv "$requests.new" "$requests"
session=$(IFS= read -r stat </proc/$$/stat && set -- ${stat##*) } && echo "$4") mine=" $$ "
list
before="$mine$found "
trap 'trap "" INT TERM; stop; exit 0' INT TERM
{ sleep 30 && echo first >&3; } 2>/dev/null &
while :; do
  read -r word run code <&3 || continue # a signal
  case $word in
    first) [ "$number" != 0 ] || start "$@" ;;
    restart) stop && wait && start "$@" && echo "[rigel-k8s] started" ;;
    ended) [ "$run" != "$number" ] || echo "[rigel-k8s] ended with exit code $code; the next change starts it again" ;;
  esac
done

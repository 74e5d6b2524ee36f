# Becomes a Python that has the modules of one of ROS' programs; sourced by scripts that have set $folder.
#
# Why: modules of ROS 1 are those of the Python that its programs use; images of different ages have python3,
# python or python2.
# Contract: `become_python PROGRAM SCRIPT [ARGUMENT...]` becomes SCRIPT in $folder with the Python of PROGRAM, with any
# if PROGRAM is empty or has none. It returns if the image has no Python. Needs sh.

become_python() {
  program=$1 script=$folder/$2
  shift 2
  if [ -n "$program" ] && found=$(command -v "$program"); then
    IFS= read -r first <"$found"
    case $first in
    '#!'*python*) exec ${first#??} -B "$script" "$@" ;;
    esac
  fi
  for python in python3 python python2; do
    if command -v "$python" >/dev/null 2>&1; then
      exec "$python" -B "$script" "$@"
    fi
  done
}

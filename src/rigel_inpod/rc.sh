# Sourced: gives this shell the environment that the container's ROS node has.
#
# Why: `kubectl exec` does not pass through the image's entry point, which is what sources
# /opt/ros/$ROS_DISTRO/setup.bash and the workspaces; so `rostopic` or `ros2` is not found there. The
# running node has that environment, and /proc shows it.
# Contract: PROMPT_COMMAND=". /rigel-k8s/rc.sh" in the pod's environment makes an interactive bash
# source this before its first prompt; exec.sh sources it for any command. Takes the variables of
# the process whose ROS_PACKAGE_PATH (ROS 1) or AMENT_PREFIX_PATH (ROS 2) is the longest: a workspace
# comes on top of its base, and process 1 may be a shell that had not sourced it when it started.
# Without such a process, it sources the distribution's own setup. If there is a discovery server,
# tools here become super clients: the server sends others only what concerns their own topics.
# RIGEL_K8S_EXEC marks what is started from here: the readiness probe (container.py) must not take a
# tool for one of the pod's nodes. The layer (rmw.sh) is for the node alone: it is taken out again.
# Needs sh and tr; sets nothing but exported variables.

unset PROMPT_COMMAND

# Sets $_rigel_environ of process $1, a variable a line; a value's own line ends become character 1.
_rigel_read() {
  _rigel_environ="
$({ tr '\n\0' '\001\n' <"/proc/$1/environ"; } 2>/dev/null)
"
}

# Sets $_rigel_value to the value of variable $1 in $_rigel_environ; fails if it is not there.
_rigel_get() {
  case $_rigel_environ in *"
$1="*) ;; *) return 1 ;; esac
  _rigel_value=${_rigel_environ#*"
$1="}
  _rigel_value=${_rigel_value%%"
"*}
}

# Sets $_rigel_best to the process to copy the environment of; fails if no process has one.
_rigel_find() {
  _rigel_best= _rigel_length=0
  for _rigel_line in /proc/[0-9]*; do
    [ "${_rigel_line#/proc/}" = $$ ] && continue
    _rigel_read "${_rigel_line#/proc/}"
    _rigel_get ROS_PACKAGE_PATH || _rigel_get AMENT_PREFIX_PATH || continue
    if [ ${#_rigel_value} -gt "$_rigel_length" ]; then
      _rigel_length=${#_rigel_value} _rigel_best=${_rigel_line#/proc/}
    fi
  done
  [ -n "$_rigel_best" ]
}

# Exports the variables of $_rigel_environ except those that belong to a shell or a terminal.
_rigel_take() {
  _rigel_one=$(printf '\001')
  while IFS= read -r _rigel_line; do
    case ${_rigel_line%%=*} in
      '' | [0-9]* | *[!A-Za-z0-9_]*) continue ;;
      PROMPT_COMMAND | PWD | OLDPWD | SHLVL | TERM | COLUMNS | LINES | HOME | _) continue ;;
      IFS | PPID | UID | EUID | BASHOPTS | SHELLOPTS | BASH_VERSINFO) continue ;;
    esac
    case $_rigel_line in *"$_rigel_one"*)
      _rigel_line=$(printf '%s.' "$_rigel_line" | tr '\001' '\n')
      _rigel_line=${_rigel_line%.}
      ;;
    esac
    export "$_rigel_line"
  done <<EOF
$_rigel_environ
EOF
}

if _rigel_find; then
  _rigel_read "$_rigel_best"
  _rigel_take
elif [ -r "/opt/ros/${ROS_DISTRO:-}/setup.sh" ]; then
  . "/opt/ros/$ROS_DISTRO/setup.sh"
fi
case ${LD_PRELOAD:-} in /rigel-k8s/rmw-*.so*)
  LD_PRELOAD=${LD_PRELOAD#/rigel-k8s/rmw-*.so}
  LD_PRELOAD=${LD_PRELOAD#:}
  [ -n "$LD_PRELOAD" ] || unset LD_PRELOAD
  ;;
esac
if [ $$ != 1 ]; then export RIGEL_K8S_EXEC=1; fi
if [ -n "${ROS_DISCOVERY_SERVER:-}" ]; then export ROS_SUPER_CLIENT=TRUE; fi
unset -f _rigel_read _rigel_get _rigel_find _rigel_take
unset _rigel_best _rigel_environ _rigel_length _rigel_line _rigel_one _rigel_value

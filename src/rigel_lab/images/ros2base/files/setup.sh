# The ROS 2 environment, as the official image's file of this name sets it; sh, bash and zsh.

# Sourcing this file twice, or after a workspace's, changes nothing.
_rigel_ros=/opt/ros/@DISTRO@
_rigel_with() {
  case ":$2:" in
    *":$1:"*) printf %s "$2" ;;
    *) printf %s "$1${2:+:$2}" ;;
  esac
}
AMENT_PREFIX_PATH="$(_rigel_with "$_rigel_ros" "${AMENT_PREFIX_PATH:-}")"
LD_LIBRARY_PATH="$(_rigel_with "$_rigel_ros/lib" "${LD_LIBRARY_PATH:-}")"
PATH="$(_rigel_with "$_rigel_ros/bin" "$PATH")"
PYTHONPATH="$(_rigel_with "$_rigel_ros/lib/python3.11/site-packages" "${PYTHONPATH:-}")"
ROS_DISTRO=@DISTRO@
ROS_PYTHON_VERSION=3
ROS_VERSION=2
export AMENT_PREFIX_PATH LD_LIBRARY_PATH PATH PYTHONPATH ROS_DISTRO ROS_PYTHON_VERSION ROS_VERSION
unset -f _rigel_with
unset _rigel_ros

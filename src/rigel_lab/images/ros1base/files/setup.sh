# The ROS 1 environment, as the official image's file of this name sets it; sh, bash and zsh.
# Debian has ROS in /usr, so PYTHONPATH and LD_LIBRARY_PATH need nothing.

# Sourcing this file twice, or after a workspace's, starts again from the base, as catkin does it.
_rigel_ros=/opt/ros/noetic
case ":$PATH:" in
  *":$_rigel_ros/bin:"*) ;;
  *) PATH="$_rigel_ros/bin:$PATH" ;;
esac
case "${1:-}" in
  --extend)
    case ":${CMAKE_PREFIX_PATH:-}:" in
      *":$_rigel_ros:"*) ;;
      *)
        CMAKE_PREFIX_PATH="${CMAKE_PREFIX_PATH:+$CMAKE_PREFIX_PATH:}$_rigel_ros"
        ROS_PACKAGE_PATH="${ROS_PACKAGE_PATH:+$ROS_PACKAGE_PATH:}$_rigel_ros/share"
        ;;
    esac
    ;;
  *)
    CMAKE_PREFIX_PATH="$_rigel_ros"
    ROS_PACKAGE_PATH="$_rigel_ros/share"
    ;;
esac
ROS_DISTRO=noetic
ROS_ETC_DIR="$_rigel_ros/etc/ros"
ROS_MASTER_URI="${ROS_MASTER_URI:-http://localhost:11311}"
ROS_PYTHON_VERSION=3
ROS_ROOT="$_rigel_ros/share/ros"
ROS_VERSION=1
export CMAKE_PREFIX_PATH PATH ROS_DISTRO ROS_ETC_DIR ROS_MASTER_URI ROS_PACKAGE_PATH
export ROS_PYTHON_VERSION ROS_ROOT ROS_VERSION
unset _rigel_ros

"""Which message types of ROS begin with a std_msgs/Header.

Why: DDS sends only a type's name, not its definition; so the names are listed here, from the .msg
files of common_interfaces, geometry2 and a few packages that robots use.
"""

from __future__ import annotations

_TYPES = {
    "ackermann_msgs": "AckermannDriveStamped",
    "control_msgs": "DynamicJointState JointControllerState JointJog JointTrajectoryControllerState"
    " PidState",
    "diagnostic_msgs": "DiagnosticArray",
    "map_msgs": "OccupancyGridUpdate PointCloud2Update",
    "nav2_msgs": "BehaviorTreeLog Costmap ParticleCloud VoxelGrid",
    "nav_msgs": "GridCells OccupancyGrid Odometry Path",
    "radar_msgs": "RadarScan RadarTracks",
    "sensor_msgs": "BatteryState CameraInfo CompressedImage FluidPressure Illuminance Image Imu"
    " JointState Joy LaserScan MagneticField MultiDOFJointState MultiEchoLaserScan NavSatFix"
    " PointCloud PointCloud2 Range RelativeHumidity Temperature TimeReference",
    "std_msgs": "Header",
    "stereo_msgs": "DisparityImage",
    "trajectory_msgs": "JointTrajectory MultiDOFJointTrajectory",
    "vision_msgs": "Classification Detection2D Detection2DArray Detection3D Detection3DArray"
    " LabelInfo VisionInfo",
    "visualization_msgs": "ImageMarker InteractiveMarker Marker",
}
_NAMES = frozenset(
    f"{package}/msg/{name}" for package, names in _TYPES.items() for name in names.split()
)
#: Types whose first field is a list of elements that begin with a header.
_LISTED = frozenset({"tf2_msgs/msg/TFMessage", "visualization_msgs/msg/MarkerArray"})


def is_stamped(type_name: str) -> bool:
    """Whether messages of a type (`sensor_msgs/msg/Image`) begin with a header, or a list of it."""
    stamped = type_name.startswith("geometry_msgs/msg/") and type_name.endswith("Stamped")
    return stamped or type_name in _NAMES or type_name in _LISTED


def is_listed(type_name: str) -> bool:
    """Whether the header is that of a list's first element."""
    return type_name in _LISTED

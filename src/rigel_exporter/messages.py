"""Reads the few ROS messages that become metrics: ROS 1's serialization and CDR, without ROS.

A header's stamp, /diagnostics, /clock, /tf and the nodes of a DDS participant are read, nothing
else. `ros1` and `cdr` make a reader of a payload; the functions below them read the message. All
raise `Unreadable` if the payload is not such a message.
"""

from __future__ import annotations

from struct import error, unpack_from
from typing import Any, Union

Payload = Union[bytes, memoryview]
_GIDS = (16, 24)  # bytes of a GUID in ros_discovery_info: since iron, before it
_GUID = 16
_DELIMITED = (0x08, 0x09)  # XCDR2 with the size of a struct in front of it
_MOST = 10_000  # elements of a sequence that are read


class Unreadable(ValueError):
    """A payload is not of the announced type."""


class Reader:
    """A payload that is read from its beginning to its end.

    Args:
        order: of bytes, as in `struct`.
        widest: the largest alignment of a number; 1 for none.
        is_counted: whether each Header begins with a sequence number.
    """

    def __init__(self, raw: Payload, at: int, *, order: str, widest: int, is_counted: bool) -> None:
        self.raw, self.at = raw, at
        self._order, self._widest, self._is_counted = order, widest, is_counted

    def take(self, code: str, size: int) -> Any:
        """Return a number of `size` bytes."""
        step = min(size, self._widest)
        self.at += -(self.at - 4) % step
        try:
            (value,) = unpack_from(self._order + code, self.raw, self.at)
        except error as cause:
            raise Unreadable("a payload ends before it should") from cause
        self.at += size
        return value

    def count(self) -> int:
        """Return the length of a sequence."""
        length = int(self.take("I", 4))
        if length > min(_MOST, len(self.raw)):
            raise Unreadable(f"a sequence of {length} in {len(self.raw)} bytes")
        return length

    def text(self) -> str:
        """Return a string."""
        length = int(self.take("I", 4))
        if length > len(self.raw) - self.at:
            raise Unreadable("a text ends after its payload")
        raw = bytes(self.raw[self.at : self.at + length])
        self.at += length
        return raw.rstrip(b"\0").decode("utf-8", "replace")

    def time(self) -> float:
        """Return a time in seconds."""
        seconds = self.take("i", 4)
        return float(seconds + self.take("I", 4) / 1e9)

    def stamp(self) -> float:
        """Return the stamp of a Header, which begins here, in seconds."""
        if self._is_counted:
            self.take("I", 4)
        return self.time()

    def guid(self, size: int) -> bytes:
        """Return a GUID of so many bytes; those of the longer form end with zeros."""
        self.at += size
        return bytes(self.raw[self.at - size : self.at - size + _GUID])


def ros1(payload: Payload) -> Reader:
    """Return a reader of ROS 1's serialization."""
    return Reader(payload, 0, order="<", widest=1, is_counted=True)


def cdr(payload: Payload) -> Reader:
    """Return a reader of CDR, which begins with four bytes of encapsulation."""
    if len(payload) < 4:
        raise Unreadable("a payload without its encapsulation")
    kind = payload[1]
    return Reader(
        payload,
        8 if kind in _DELIMITED else 4,
        order="<" if kind & 1 else ">",
        widest=4 if kind >= 0x06 else 8,
        is_counted=False,
    )


def diagnostics(reader: Reader) -> list[tuple[str, str, int]]:
    """Return (name, hardware id, level) of each status of a diagnostic_msgs/DiagnosticArray."""
    reader.stamp()
    reader.text()
    return [_status(reader) for _ in range(reader.count())]


def _status(reader: Reader) -> tuple[str, str, int]:
    level, name, _, hardware = reader.take("B", 1), reader.text(), reader.text(), reader.text()
    for _ in range(2 * reader.count()):  # keys and values
        reader.text()
    return name, hardware, level


def transforms(reader: Reader) -> list[tuple[str, str, float]]:
    """Return (parent, child, stamp in seconds) of each transform of a tf2_msgs/TFMessage."""
    return [_transform(reader) for _ in range(reader.count())]


def _transform(reader: Reader) -> tuple[str, str, float]:
    when, parent, child = reader.stamp(), reader.text(), reader.text()
    for _ in range(7):  # a vector and a quaternion
        reader.take("d", 8)
    return parent, child, when


def nodes(payload: Payload) -> dict[str, frozenset[bytes]]:
    """Return the nodes of a participant: name with namespace -> its endpoints' GUIDs.

    A rmw_dds_common/ParticipantEntitiesInfo does not contain the length of its GUIDs: it is the one
    with which the payload ends where it should.
    """
    for size in _GIDS:
        try:
            return _nodes(cdr(payload), size)
        except Unreadable as cause:
            reason = cause
    raise reason


def _nodes(reader: Reader, gid: int) -> dict[str, frozenset[bytes]]:
    reader.guid(gid)
    found: dict[str, frozenset[bytes]] = {}
    for _ in range(reader.count()):
        namespace, name = reader.text(), reader.text()
        full = namespace.rstrip("/") + "/" + name
        if not namespace.startswith("/") or not name:
            raise Unreadable(f"not a node's name: {full!r}")
        guids = [reader.guid(gid) for _ in range(2) for _ in range(reader.count())]
        found[full] = found.get(full, frozenset()).union(guids)
    if not 0 <= len(reader.raw) - reader.at < 4:  # writers fill up to four bytes
        raise Unreadable("nodes do not end where their payload does")
    return found


# -- which types begin with a Header --


def has_header(definition: str) -> bool:
    """Return whether the first field of a ROS 1 message definition is a Header."""
    for line in definition.splitlines():
        words = line.partition("#")[0].split()
        if words and "=" not in line.partition("#")[0]:
            return words[0] in ("Header", "std_msgs/Header")
        if line.startswith("===="):
            return False
    return False


def stamp(payload: Payload, type_name: str) -> float | None:
    """Return the header's stamp in CDR, None for a type that does not begin with a header.

    The first fragment of a message is enough. An empty list of stamped things has no stamp.
    """
    is_pose = type_name.startswith("geometry_msgs/msg/") and type_name.endswith("Stamped")
    if not is_pose and type_name not in _STAMPED and type_name not in _LISTS:
        return None
    reader = cdr(payload)
    if type_name in _LISTS and reader.take("I", 4) == 0:
        return None
    return reader.stamp()


#: DDS sends only a type's name. These are the .msg files of common_interfaces, geometry2 and a few
#: packages that robots use.
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
_STAMPED = frozenset(
    f"{package}/msg/{name}" for package, names in _TYPES.items() for name in names.split()
)
#: Types whose first field is a list of elements that begin with a header.
_LISTS = frozenset({"tf2_msgs/msg/TFMessage", "visualization_msgs/msg/MarkerArray"})

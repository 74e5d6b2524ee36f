"""A layout for Foxglove and Lichtblick: panels for what a ROS graph publishes; pure.

The names of panels, their keys and the tree are those of layouts that these programs export. A key
that is not set has the panel's default.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import Any

from rigel_graph.types import FEEDBACK, GraphTopic

#: Types are written as in ROS 1. The 3D panel shows frames without being configured to.
FRAMES = frozenset({"tf/tfMessage", "tf2_msgs/TFMessage"})
SHOWN_IN_3D = frozenset(
    {
        *("nav_msgs/OccupancyGrid", "nav_msgs/Path"),
        *("sensor_msgs/LaserScan", "sensor_msgs/PointCloud2"),
        *("visualization_msgs/Marker", "visualization_msgs/MarkerArray"),
        *("geometry_msgs/PolygonStamped", "geometry_msgs/PoseArray", "geometry_msgs/PoseStamped"),
        "geometry_msgs/PoseWithCovarianceStamped",
    }
)
#: The robot's model: a topic in ROS 2; a parameter in ROS 1, which the 3D panel has as `param:`.
MODEL = "/robot_description"
IMAGES = frozenset({"sensor_msgs/CompressedImage", "sensor_msgs/Image"})
MOST_IMAGES = 4
#: The fields of each plot, by type.
PLOTS: dict[str, dict[str, tuple[str, ...]]] = {
    "speed": {
        "geometry_msgs/Twist": ("linear.x", "angular.z"),
        "geometry_msgs/TwistStamped": ("twist.linear.x", "twist.angular.z"),
        "nav_msgs/Odometry": ("twist.twist.linear.x", "twist.twist.angular.z"),
    },
    "range": {"sensor_msgs/Range": ("range",)},
    "imu": {"sensor_msgs/Imu": ("linear_acceleration.x", "angular_velocity.z")},
    "battery": {"sensor_msgs/BatteryState": ("percentage",)},
}
SCENE, LOG = "3D!scene", "RosOut!log"


def make_layout(topics: Iterable[GraphTopic], expected: Collection[str] = ()) -> dict[str, Any]:
    """Return a layout's document; the same for the same graph.

    Args:
        expected: topics that come before others where not all have a place.
    """
    public = (t for t in topics if t.publishers and t.is_public and not t.name.endswith(FEEDBACK))
    types = {
        topic.name: topic.type
        for topic in sorted(public, key=lambda topic: (topic.name not in expected, topic.name))
    }
    panels = dict(choose_panels(types))
    if types and not panels:
        panels["RawMessages!first"] = {"topicPath": next(iter(types))}
    panels[LOG] = {"topicToRender": "/rosout"}
    tree = split([panel for panel in panels if panel != SCENE], "column", "row")
    if SCENE in panels:
        tree = {"direction": "row", "first": SCENE, "second": tree}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": tree,
    }


def choose_panels(types: dict[str, str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the panels that fit topics, by their names and types: a panel's key and its values."""
    kinds = {name: kind.replace("/msg/", "/") for name, kind in types.items()}
    scene = [name for name, kind in kinds.items() if kind in SHOWN_IN_3D or name == MODEL]
    if scene or FRAMES.intersection(kinds.values()):
        if kinds == types:  # ROS 1
            scene.append(f"param:{MODEL}")
        yield SCENE, {"topics": {name: {"visible": True} for name in scene}}
    for number, name in enumerate(choose_images(kinds)[:MOST_IMAGES], 1):
        yield f"Image!{number}", {"imageMode": {"imageTopic": name}}
    for title, fields in PLOTS.items():
        paths = [f"{name}.{path}" for name, kind in kinds.items() for path in fields.get(kind, ())]
        if paths:
            lines = [{"value": p, "enabled": True, "timestampMethod": "receiveTime"} for p in paths]
            yield f"Plot!{title}", {"paths": lines}
    health = [name for name, kind in kinds.items() if kind == "diagnostic_msgs/DiagnosticArray"]
    if health:
        yield "DiagnosticSummary!health", {"topicToRender": health[0]}


def choose_images(kinds: dict[str, str]) -> list[str]:
    """Return the topics of images; of one camera that which takes the least bandwidth."""
    names = [name for name, kind in kinds.items() if kind in IMAGES]
    # image_transport's compressedDepth is a format of its own, which no browser decodes.
    return [
        name
        for name in names
        if not name.endswith("/compressedDepth") and f"{name}/compressed" not in names
    ]


def split(panels: Sequence[str], way: str, other: str) -> str | dict[str, Any]:
    """Return panels as a tree that halves the area, in one direction and then in the other."""
    if len(panels) == 1:
        return panels[0]
    half = len(panels) // 2
    first, second = (split(part, other, way) for part in (panels[:half], panels[half:]))
    return {"direction": way, "first": first, "second": second}

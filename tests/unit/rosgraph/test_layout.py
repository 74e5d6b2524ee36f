"""The layout for Foxglove and Lichtblick: which panels a graph gets.

The form is what Lichtblick's import checks, and what it and Foxglove export.
"""

from __future__ import annotations

from typing import Any

import pytest

from rigel_graph.layout import make_layout
from rigel_graph.types import GraphTopic

LOG = "RosOut!log"
#: Types that have a panel, in ROS 2.
TYPES = {
    "/battery": "sensor_msgs/msg/BatteryState",
    "/camera/image_raw": "sensor_msgs/msg/Image",
    "/cmd_vel": "geometry_msgs/msg/Twist",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/imu": "sensor_msgs/msg/Imu",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/odom": "nav_msgs/msg/Odometry",
    "/robot_description": "std_msgs/msg/String",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/sonar": "sensor_msgs/msg/Range",
    "/tf": "tf2_msgs/msg/TFMessage",
}


def draw(types: dict[str, str], *expected: str) -> dict[str, Any]:
    """Return the layout of topics that are published; each panel is in its tree once."""
    made = make_layout([GraphTopic(name, kind, ("/a",)) for name, kind in types.items()], expected)
    assert list_leaves(made["layout"]) == sorted(made["configById"])
    return made


def list_leaves(tree: str | dict[str, Any]) -> list[str]:
    if isinstance(tree, str):
        return [tree]
    assert tree.keys() == {"direction", "first", "second"}
    assert tree["direction"] in ("row", "column")
    return sorted([*list_leaves(tree["first"]), *list_leaves(tree["second"])])


def panels(types: dict[str, str], *expected: str) -> dict[str, Any]:
    """Return the panels beside that of the log, by their keys."""
    found = dict(draw(types, *expected)["configById"])
    assert found.pop(LOG) == {"topicToRender": "/rosout"}
    return found


def list_images(types: dict[str, str], *expected: str) -> list[str]:
    found = panels(types, *expected)
    return [one["imageMode"]["imageTopic"] for key, one in found.items() if key[:6] == "Image!"]


def list_paths(found: dict[str, Any], plot: str) -> list[str]:
    series = found[f"Plot!{plot}"]["paths"]
    assert all(one["enabled"] and one["timestampMethod"] == "receiveTime" for one in series)
    return [one["value"] for one in series]


def test_an_empty_graph_has_the_log_alone() -> None:
    """With all keys that an import requires; a layout of one panel is its key."""
    assert draw({}) == {
        "configById": {LOG: {"topicToRender": "/rosout"}},
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": LOG,
    }


def test_a_robot_has_a_panel_for_each_kind() -> None:
    found = panels(TYPES)
    assert [*found] == [
        "3D!scene",
        "Image!1",
        *("Plot!speed", "Plot!range", "Plot!imu", "Plot!battery"),
        "DiagnosticSummary!health",
    ]
    assert found["DiagnosticSummary!health"] == {"topicToRender": "/diagnostics"}
    assert found["3D!scene"]["topics"] == {
        name: {"visible": True} for name in ("/map", "/robot_description", "/scan")
    }
    assert list_paths(found, "speed") == [
        *("/cmd_vel.linear.x", "/cmd_vel.angular.z"),
        *("/odom.twist.twist.linear.x", "/odom.twist.twist.angular.z"),
    ]
    assert list_paths(found, "battery") == ["/battery.percentage"]
    assert list_paths(found, "range") == ["/sonar.range"]
    assert list_paths(found, "imu") == ["/imu.linear_acceleration.x", "/imu.angular_velocity.z"]


def test_the_scene_is_the_left_half() -> None:
    """The others are beside it, in the order of their panels."""
    tree = draw(TYPES)["layout"]
    assert (tree["direction"], tree["first"]) == ("row", "3D!scene")
    assert tree["second"]["direction"] == "column"


def test_types_of_ros_1_are_the_same() -> None:
    """The robot's model is a parameter there."""
    old = {name: kind.replace("/msg/", "/") for name, kind in TYPES.items()}
    del old["/robot_description"]
    found, expected = panels(old), panels(TYPES)
    shown = found["3D!scene"]["topics"]
    shown["/robot_description"] = shown.pop("param:/robot_description")
    assert found == expected


@pytest.mark.parametrize("kind", ["tf2_msgs/msg/TFMessage", "tf2_msgs/TFMessage", "tf/tfMessage"])
def test_frames_alone_have_a_scene(kind: str) -> None:
    """Which shows them without a setting."""
    assert "/tf" not in panels({"/tf": kind})["3D!scene"]["topics"]


def test_the_order_of_topics_does_not_matter() -> None:
    assert draw(TYPES) == draw(dict(reversed(TYPES.items())))


def test_a_topic_without_publisher_has_no_panel() -> None:
    """It would stay empty."""
    topics = [GraphTopic(name, kind, (), ("/a",)) for name, kind in TYPES.items()]
    assert [*make_layout(topics)["configById"]] == [LOG]


def test_four_images_at_most_those_that_are_expected_first() -> None:
    cameras = {f"/camera{number}": "sensor_msgs/msg/Image" for number in range(6)}
    assert list_images(cameras) == ["/camera0", "/camera1", "/camera2", "/camera3"]
    assert list_images(cameras, "/camera5") == ["/camera5", "/camera0", "/camera1", "/camera2"]


def test_a_camera_has_one_panel() -> None:
    """Its compressed images if it has some, never those that no viewer decodes."""
    packed = "sensor_msgs/msg/CompressedImage"
    raw = {"/a/image": "sensor_msgs/msg/Image", "/b/depth": "sensor_msgs/msg/Image"}
    more = {"/a/image/compressed": packed, "/b/depth/compressedDepth": packed}
    assert list_images(raw | more) == ["/a/image/compressed", "/b/depth"]


def test_what_fits_no_other_panel_is_shown_as_text() -> None:
    """One topic: that is expected, otherwise the first that a user's nodes publish."""
    text = {
        "/goal/_action/feedback": "a/action/B_FeedbackMessage",
        "/parameter_events": "rcl_interfaces/msg/ParameterEvent",
        "/status": "a/msg/B",
        "/talk": "std_msgs/msg/String",
    }
    assert panels(text) == {"RawMessages!first": {"topicPath": "/status"}}
    assert panels(text, "/nowhere", "/talk") == {"RawMessages!first": {"topicPath": "/talk"}}
    assert "RawMessages!first" not in panels(text | TYPES)

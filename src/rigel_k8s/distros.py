"""The ROS distributions; plain data."""

from __future__ import annotations

ROS1 = frozenset(("hydro", "indigo", "jade", "kinetic", "lunar", "melodic", "noetic"))

ROS2 = frozenset(
    ("ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic")
    + ("humble", "iron", "jazzy", "kilted", "lyrical", "rolling")
)

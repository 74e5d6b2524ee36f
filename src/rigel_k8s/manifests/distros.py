"""Which ROS a distribution is; no image and no cluster is asked."""

from __future__ import annotations

__all__ = ["is_ros1"]

ROS2 = frozenset(
    ("ardent", "bouncy", "crystal", "dashing", "eloquent", "foxy", "galactic")
    + ("humble", "iron", "jazzy", "kilted", "lyrical", "rolling")
)


def is_ros1(distro: str) -> bool:
    """Return whether a distribution is of ROS 1; one of a user's own is taken for that."""
    return distro.lower() not in ROS2

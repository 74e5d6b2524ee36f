"""Which ROS a distribution is, without a look at images or the cluster."""

from __future__ import annotations

import difflib
from datetime import date

from rigel_k8s.distros import ROS1, ROS2
from rigel_k8s.objects.naming import Ros


def is_ros1(distro: str) -> bool:
    """Return whether a distribution is of ROS 1; a user's own counts as ROS 1."""
    return distro.lower() not in ROS2


def ros_of(distro: str, chosen: Ros | None = None) -> Ros:
    """Return the ROS of an application: the chosen one, else that of its distro."""
    return chosen or ("1" if is_ros1(distro) else "2")


def guess_distro(distro: str) -> str | None:
    """Return the distribution that an unknown name was probably meant to be."""
    known = sorted({*ROS1, *ROS2})
    if distro.lower() in known:
        return None
    return next(iter(difflib.get_close_matches(distro.lower(), known, n=1, cutoff=0.7)), None)


def find_end(distro: str, today: date) -> date | None:
    """Return the last day of a distribution's support if it is over.

    noetic has none: there is no newer ROS 1 to move to.
    """
    ends = {**ROS1, **ROS2, "noetic": date.max}
    end = ends.get(distro.lower(), date.max)
    return end if end < today else None

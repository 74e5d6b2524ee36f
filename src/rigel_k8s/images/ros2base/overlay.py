"""What neither Debian nor the wheels have of the official ROS 2 image: one small layer, pure."""

from __future__ import annotations

from importlib.resources import files

from rigel_k8s.images.base.layer import ENTRYPOINT, Entry
from rigel_k8s.images.ros2base.packages import Distro

__all__ = ["entries", "prefix"]


def prefix(distro: Distro) -> str:
    """Return where ROS is, relative to the root."""
    return f"opt/ros/{distro}"


def entries(distro: Distro) -> tuple[Entry, ...]:
    """Return all files of the layer, sorted by path."""
    own = files("rigel_k8s.images.ros2base") / "files"
    scripts = (
        Entry(
            f"{prefix(distro)}/setup.{shell}",
            (own / f"setup.{shell}").read_bytes().replace(b"@DISTRO@", distro.encode()),
        )
        for shell in ("bash", "sh", "zsh")
    )
    return tuple(sorted((ENTRYPOINT, *scripts), key=lambda e: e.path))

"""What Debian and the wheels do not have of the official ROS 2 image: one small layer, pure."""

from __future__ import annotations

from importlib.resources import files

from rigel_k8s.system.oci import Entry
from rigel_lab.images.base.layer import ENTRYPOINT
from rigel_lab.images.ros2base.packages import Distro

_SETUP = ("setup.bash", "setup.sh", "setup.zsh")


def prefix(distro: Distro) -> str:
    """Return the place of ROS, relative to the root."""
    return f"opt/ros/{distro}"


def entries(distro: Distro) -> tuple[Entry, ...]:
    """Return all files of the layer, sorted by path."""
    own = files("rigel_lab.images.ros2base") / "files"
    where = prefix(distro)

    def script(name: str) -> bytes:
        return (own / name).read_bytes().replace(b"@DISTRO@", distro.encode())

    scripts = (Entry(f"{where}/{name}", script(name)) for name in _SETUP)
    command = Entry(f"{where}/bin/ros2", script("ros2.sh"), mode=0o755)
    parts = (
        Entry(f"{where}/share/rigel_ros2/{part.name}", part.read_bytes())
        for part in (own / "ros2").iterdir()
        if part.name.endswith(".py")
    )
    return tuple(sorted((ENTRYPOINT, command, *scripts, *parts), key=lambda e: e.path))

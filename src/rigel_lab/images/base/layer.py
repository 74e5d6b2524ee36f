"""What the images of both ROS have in common: their entrypoint and configuration."""

from __future__ import annotations

from importlib.resources import files

from rigel_k8s.system.oci import Entry

#: The script that official ROS images start everything with.
ENTRYPOINT = Entry(
    "ros_entrypoint.sh",
    (files("rigel_lab.images.base") / "files" / "ros_entrypoint.sh").read_bytes(),
    mode=0o755,
)


def config(distro: str) -> dict[str, list[str]]:
    """Return an image's configuration; LANG as in the official image, so Python writes UTF-8."""
    return {
        "Entrypoint": ["/ros_entrypoint.sh"],
        "Cmd": ["bash"],
        "Env": [
            "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
            "LANG=C.UTF-8",
            "LC_ALL=C.UTF-8",
            f"ROS_DISTRO={distro}",
        ],
    }

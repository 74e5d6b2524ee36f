"""Which Debian packages and wheels make a ROS 2; plain data."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from types import MappingProxyType
from typing import Literal, TypeAlias

#: The distributions for which PyPI has wheels.
Distro: TypeAlias = Literal["jazzy", "kilted"]

#: There are wheels for its Python; the ROS 1 image is based on it, too.
SUITE = "bookworm"
PYTHON = "3.11"
#: There are none for another processor.
PLATFORM = "manylinux_2_28_x86_64"

REFERENCES: Mapping[Distro, str] = MappingProxyType(
    {
        "jazzy": "localhost/rigel-k8s/ros:jazzy",
        "kilted": "localhost/rigel-k8s/ros:kilted",
    }
)

#: numpy and yaml are Debian's, as they are Ubuntu's in the official image: half as large as PyPI's.
PACKAGES = (
    "ca-certificates",
    "procps",
    "python-is-python3",
    "python3",
    "python3-numpy",
    # fastdds of kilted needs it.
    "python3-psutil",
    "python3-typing-extensions",
    "python3-yaml",
    # Without it apt takes usrmerge, which drags in 50 MB of Perl.
    "usr-is-merged",
)


def lock(distro: Distro) -> str:
    """Return the wheels of a distribution as a requirements file, each with its digests."""
    text = files("rigel_lab.images.ros2base") / "files" / f"{distro}.txt"
    return text.read_text("utf-8")

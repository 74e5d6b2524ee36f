"""The image that stands in for ros:jazzy where it cannot be pulled."""

from __future__ import annotations

import subprocess
import sys

from . import shared


def push_ros2(name: str, distro: str = "jazzy") -> None:
    """Build the image (once) and push it under a name."""
    words = ["ros2-base", "--distro", distro, "--push", name]
    subprocess.run([sys.executable, "-m", "rigel_lab", *words], check=True, timeout=shared.BUILDS)

"""Images that only this project's demo and tests use; `rigel image` builds those of users."""

from __future__ import annotations

import argparse
import sys

from rigel_lab.images.base.delivery import deliver
from rigel_lab.images.ros2base import REFERENCES, build


class Steps:
    """A Reporter that prints lines, without what happens within a step."""

    def line(self, text: str) -> None:
        """Print a step."""
        sys.stderr.write(f"{text}\n")

    warn = line

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Ignore what happens within a step."""


def main() -> None:
    """Build an image unless it exists, load it or push it, and print its name."""
    parser = argparse.ArgumentParser("python -m rigel_lab", description=__doc__)
    commands = parser.add_subparsers(required=True)
    image = commands.add_parser("ros2-base", help="ROS 2 from Debian and PyPI's wheels")
    image.add_argument("--distro", choices=list(REFERENCES), default="jazzy")
    image.add_argument("--push", metavar="IMAGE", help="for example HOST:PORT/ros:jazzy")
    words = parser.parse_args()
    name = deliver(build(Steps(), distro=words.distro), words.push, Steps())
    sys.stdout.write(f"{name}\n")


if __name__ == "__main__":
    main()

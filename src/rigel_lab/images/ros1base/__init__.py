"""A ROS 1 base image for machines that cannot pull `ros:noetic`, from Debian's ROS packages.

It exists because ROS 1 has ended and its images and packages disappear from more and more mirrors,
while Debian ships ROS 1 in its own archive. The image is used exactly like the official one: the
same entry point, /opt/ros/noetic/setup.bash, ROS_DISTRO, `python`, the same commands. It is
independent of Kubernetes, Rigelfiles and the images that are built on it.

packages.py   which Debian packages make a ROS 1
recipe.py     these, and what Debian's file layout is missing to look like the official image;
              images/base does the rest
"""

from __future__ import annotations

from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.ros1base.packages import REFERENCES, Variant
from rigel_lab.images.ros1base.recipe import build

__all__ = ["REFERENCES", "BaseImage", "Variant", "build"]

"""A ROS 2 base image for machines that cannot pull `ros:jazzy`, from PyPI's ROS 2 wheels.

It exists because ROS 2's binary packages come from one archive and its images from one registry,
and machines behind a proxy often reach neither, while they reach Debian and PyPI. The image is used
like the official one: the same entry point, /opt/ros/jazzy/setup.bash, ROS_DISTRO, `fastdds`. It is
independent of Kubernetes, Rigelfiles and the images that are built on it.

packages.py   which Debian packages and wheels make a ROS 2
recipe.py     these, the wheels as the tree that the official image has in /opt/ros/DISTRO, and what
              neither has: setup files, the entry point, a `ros2` command; images/base does the rest
files/        the wheels' versions and digests (`./run lock` renews them), scripts, the command
"""

from __future__ import annotations

from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.ros2base.packages import REFERENCES, Distro
from rigel_lab.images.ros2base.recipe import build

__all__ = ["REFERENCES", "BaseImage", "Distro", "build"]

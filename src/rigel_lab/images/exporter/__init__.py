"""The ROS exporter's image: Debian's Python and the exporter, nothing else and no shell.

program.py    the program's files as a layer
build.py      both as a recipe; images/base does the rest
"""

from __future__ import annotations

from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.exporter.build import REFERENCE, UPSTREAM, build
from rigel_lab.images.exporter.program import entries

__all__ = ["REFERENCE", "UPSTREAM", "BaseImage", "build", "entries"]

"""The image of Muto's agent: Debian's Python, this package and the wheels that it needs; no shell.

program.py    the package and the wheels as a layer
build.py      both as a recipe; images/base does the rest
"""

from __future__ import annotations

from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.mutoagent.build import REFERENCE, UPSTREAM, build
from rigel_lab.images.mutoagent.program import list_package, read_lock

__all__ = ["REFERENCE", "UPSTREAM", "BaseImage", "build", "list_package", "read_lock"]

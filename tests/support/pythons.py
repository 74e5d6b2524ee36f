"""Pythons of other versions, as older ROS images have them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest


def find_python(version: str) -> str:
    """Return a Python of this version, from pyenv or the PATH; skip the test without one."""
    pyenv = Path.home() / ".pyenv" / "versions"
    found = [str(path) for path in sorted(pyenv.glob(f"{version}.*/bin/python{version}"))]
    on_path = shutil.which(f"python{version}")
    if not found and (on_path is None or "shims" in on_path):
        pytest.skip(f"no Python {version} on this machine")
    return found[0] if found else str(on_path)

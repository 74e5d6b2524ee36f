"""What the tests of the mounted scripts share: the Pythons that run them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest


@pytest.fixture
def python2() -> str:
    """A Python 2.7, from pyenv or the PATH."""
    pyenv = Path.home() / ".pyenv" / "versions"
    found = [str(path) for path in sorted(pyenv.glob("2.7.*/bin/python2.7"))]
    on_path = shutil.which("python2.7")
    if not found and (on_path is None or "shims" in on_path):
        pytest.skip("no Python 2.7 on this machine")
    return found[0] if found else str(on_path)

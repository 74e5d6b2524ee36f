"""What the tests of the mounted scripts share: the Pythons that run them."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest


@pytest.fixture
def python2() -> str:
    """A Python 2.7, from pyenv or the PATH."""
    return python("2.7")


@pytest.fixture
def python36() -> str:
    """A Python 3.6, from pyenv or the PATH."""
    return python("3.6")


def python(version: str) -> str:
    pyenv = Path.home() / ".pyenv" / "versions"
    found = [str(path) for path in sorted(pyenv.glob(f"{version}.*/bin/python{version}"))]
    on_path = shutil.which(f"python{version}")
    if not found and (on_path is None or "shims" in on_path):
        pytest.skip(f"no Python {version} on this machine")
    return found[0] if found else str(on_path)

"""What the tests of the mounted scripts share: the scripts as modules, and the Pythons."""

from __future__ import annotations

import importlib
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

import rigel_k8s.inpod

ROOM = Path(rigel_k8s.inpod.__file__).parent


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], ModuleType]]:
    """Import a script and its neighbours as they import one another in a pod, for one test."""
    names = {path.stem for path in ROOM.glob("*.py")} - {"__init__"}
    before = {name: sys.modules.pop(name) for name in names & set(sys.modules)}
    monkeypatch.syspath_prepend(str(ROOM))
    yield importlib.import_module
    for name in names:
        sys.modules.pop(name, None)
    sys.modules.update(before)


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

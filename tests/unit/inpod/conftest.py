"""What the tests of the mounted scripts share: the scripts as modules, and the Pythons."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest

import rigel_inpod
from tests.support.pythons import find_python

ROOM = Path(rigel_inpod.__file__).parent


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
    return find_python("2.7")


@pytest.fixture
def python36() -> str:
    """A Python 3.6, from pyenv or the PATH."""
    return find_python("3.6")

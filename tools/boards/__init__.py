"""Writes the dashboards' JSON from descriptions in Python: `python -m tools.boards`.

The descriptions use Grafana's own builders, so a wrong key is a type error. The builders need
Python 3.11. The JSON is in the repository, so only a change of a dashboard needs them.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import rigel_stack.boards
from tools.boards import dashboards
from tools.boards.board import Board

__all__ = ["FILES", "texts", "write"]

#: Where the JSON is kept, beside the rules.
FILES = Path(rigel_stack.boards.__file__).parent / "files"


def texts() -> dict[str, str]:
    """Return the JSON of all dashboards by file name."""
    names = [module.name for module in iter_modules(dashboards.__path__)]
    modules = [import_module(f"{dashboards.__name__}.{name}") for name in names]
    found: list[Board] = [module.board() for module in modules]
    return {f"{board.uid}.json": board.text() for board in found}


def write() -> None:
    """Write the files, and remove those of removed dashboards."""
    found = texts()
    for file in FILES.glob("*.json"):
        if file.name not in found:
            file.unlink()
    for name, text in found.items():
        (FILES / name).write_text(text, encoding="utf-8")

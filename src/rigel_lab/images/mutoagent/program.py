"""The agent's files as they are in its image."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from rigel_k8s.system.oci import Entry
from rigel_lab.images.base.program import ETC, PREFIX


def read_lock() -> str:
    """Return the wheels as a requirements file, each with its digests."""
    text = files("rigel_lab.images.mutoagent") / "files" / "wheels.txt"
    return text.read_text("utf-8")


def list_package() -> tuple[Entry, ...]:
    """Return this package's files, sorted by path, and the few of /etc."""
    found = _walk(files("rigel_k8s"), f"{PREFIX}/rigel_k8s")
    return (*ETC, *sorted(found, key=lambda entry: entry.path))


def list_wheels(wheels: Iterable[Path]) -> Iterator[Entry]:
    """Yield the modules of wheels; their scripts are left out."""
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as opened:
            for info in opened.infolist():
                if not info.is_dir() and ".data/" not in info.filename:
                    yield Entry(f"{PREFIX}/{info.filename}", opened.read(info))


def _walk(directory: Any, path: str) -> Iterator[Entry]:
    for item in directory.iterdir():
        below = f"{path}/{item.name}"
        if item.is_dir():
            if item.name != "__pycache__":
                yield from _walk(item, below)
        else:
            yield Entry(below, item.read_bytes())

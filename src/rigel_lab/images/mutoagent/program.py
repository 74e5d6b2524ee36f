"""The agent's files as they are in its image."""

from __future__ import annotations

import zipfile
from collections.abc import Iterable, Iterator
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

from rigel_k8s import __version__
from rigel_k8s.system.oci import Entry
from rigel_lab.images.base.program import ETC, PREFIX

#: All but the lab: what the agent deploys has parts of each.
HOUSES = ("rigel_exporter", "rigel_gate", "rigel_inpod", "rigel_k8s", "rigel_muto")


def read_lock() -> str:
    """Return the wheels as a requirements file, each with its digests."""
    text = files("rigel_lab.images.mutoagent") / "files" / "wheels.txt"
    return text.read_text("utf-8")


def list_package() -> tuple[Entry, ...]:
    """Return this distribution's files, sorted by path, and the few of /etc."""
    found = [entry for house in HOUSES for entry in _walk(files(house), f"{PREFIX}/{house}")]
    # Its commands and job types are found by the entry points of an installed distribution.
    entries = distribution("rigel-k8s").read_text("entry_points.txt") or ""
    named = f"Metadata-Version: 2.1\nName: rigel-k8s\nVersion: {__version__}\n"
    for name, text in (("METADATA", named), ("entry_points.txt", entries)):
        path = f"{PREFIX}/rigel_k8s-{__version__}.dist-info/{name}"
        found.append(Entry(path, text.encode()))
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

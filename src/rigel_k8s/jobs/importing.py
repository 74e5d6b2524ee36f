"""Where the classes of users are imported from: what is installed, and trusted directories.

What lies next to the Rigelfile came with it, so it is imported only from a directory that
the user trusts. The same holds for the working directory, if Python searches it.
"""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path

import attrs

from rigel_k8s.system.trust import is_trusted


@attrs.frozen
class Places:
    """The directories whose modules need trust.

    Attributes:
        directories: the Rigelfile's own, and the working directory if Python searches it.
    """

    directories: tuple[Path, ...]

    @contextmanager
    def left_out(self) -> Iterator[None]:
        """Let Python search only what is installed."""
        before = list(sys.path)
        sys.path[:] = [entry for entry in before if not self._has(entry)]
        try:
            yield
        finally:
            sys.path[:] = before

    def find(self, module: str) -> tuple[Path, Path] | None:
        """Return which of these an import of a module would run code of first, and the file.

        None if the module is installed, or does not exist.
        """
        top = module.partition(".")[0]
        with self.left_out():
            try:
                installed = importlib.util.find_spec(top)
            except (ImportError, ValueError):  # `__main__`, or an empty name
                return None
        if installed and not self._lies_in(installed):
            return None
        for directory in self.directories:
            if file := find_code(module, directory):
                return directory, file
        return None

    def _has(self, entry: str) -> bool:
        return Path(entry).resolve() in self.directories

    def _lies_in(self, spec: ModuleSpec) -> bool:
        """Return whether a module that was imported before came from one of these."""
        places = spec.submodule_search_locations or ([spec.origin] if spec.origin else [])
        return any(Path(place).resolve().parent in self.directories for place in places)


def places_of(directory: Path | None) -> Places:
    """Return the places of a Rigelfile in a directory; None: there is no Rigelfile."""
    found = [directory.resolve()] if directory else []
    with suppress(FileNotFoundError):  # the working directory may have been deleted
        here = Path.cwd()
        if any(Path(entry).resolve() == here for entry in sys.path):
            found.append(here)
    return Places(tuple(dict.fromkeys(found)))


def find_code(module: str, directory: Path) -> Path | None:
    """Return the first file that an import from a directory would run; nothing is imported."""
    search, name = [str(directory)], ""
    for part in module.split("."):
        name = f"{name}.{part}" if name else part
        spec = PathFinder.find_spec(name, search)
        if spec is None:
            return None
        if spec.origin:
            return Path(spec.origin)
        search = list(spec.submodule_search_locations or ())  # a directory without __init__.py
    return None


@contextmanager
def importable(directory: Path | None) -> Iterator[None]:
    """Make modules of a trusted directory importable, as Rigel does with the Rigelfile's own."""
    place = str(directory.resolve()) if directory else ""
    if not place or place in sys.path or not is_trusted(Path(place)):
        yield
        return
    sys.path.insert(0, place)
    try:
        yield
    finally:
        if place in sys.path:
            sys.path.remove(place)


def is_own_name(module: str) -> bool:
    """Return whether a module is Python's own: it has no job type, and some run code on import."""
    return module.partition(".")[0] in sys.stdlib_module_names

"""The content of a directory as a value, written completely or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import attrs

from rigel_k8s.errors import UserError


@attrs.frozen
class File:
    """A regular file."""

    content: bytes
    executable: bool = False


@attrs.frozen
class Link:
    """A symbolic link, relative to the directory that it is in."""

    target: str


@attrs.frozen
class Directory:
    """A directory, named because it may be empty."""


Entry = File | Link | Directory
#: Entries by their paths: relative, with single slashes, without "." and "..".
Tree = Mapping[str, Entry]


def write_tree(tree: Tree, directory: Path) -> None:
    """Write a new directory.

    Links are written last, so that nothing is written through one of them.

    Raises:
        UserError: the name exists and is not an empty directory, or it cannot be written. Nothing
            is left behind.
    """
    target = directory.absolute()
    if target.is_symlink() or (target.exists() and not (target.is_dir() and is_empty(target))):
        raise UserError(
            f"{directory} already exists, and is not an empty directory",
            hint="name a new directory, or remove this one",
        )
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(prefix=f".{target.name[:200]}.", dir=target.parent))
        try:
            _fill(draft, tree)
            draft.chmod(0o755)
            draft.replace(target)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise
    except OSError as error:
        raise UserError(f"{directory} cannot be written: {error.strerror or error}") from error


def is_empty(directory: Path) -> bool:
    return next(directory.iterdir(), None) is None


def _fill(directory: Path, tree: Tree) -> None:
    for name, entry in sorted(tree.items(), key=lambda item: isinstance(item[1], Link)):
        path = directory / name
        if isinstance(entry, Directory):
            path.mkdir(parents=True, exist_ok=True)
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(entry, Link):
            path.symlink_to(entry.target)
        else:
            with path.open("xb") as file:
                file.write(entry.content)
            path.chmod(0o755 if entry.executable else 0o644)

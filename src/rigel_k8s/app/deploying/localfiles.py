"""The `files` of nodes: read for a deploy, and checked with the options."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

from rigel_k8s.app.deploying.beside import Use, collect, explain, read_each
from rigel_k8s.app.files import Folder, LocalFile
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.errors import UserError
from rigel_k8s.problems import Problem
from rigel_k8s.system.local_files import read_bytes

#: Bytes of the files of all nodes: a Secret of one mebibyte keeps a revision with all of them.
MOST_BYTES = 512 * 1024
#: Files of one folder: each is written into the pod's template.
MOST_FILES = 200
LARGER = "put large ones into the image, or on a volume of `persistent_storage`"
TOO_LARGE = UserError(
    f"the files of all nodes have more than {MOST_BYTES // 1024} KiB", hint=LARGER
)


def read_files(options: OrchestrationOptions, directory: Path, home: Path) -> dict[str, Folder]:
    """Return the files of all nodes, by their paths in the Rigelfile.

    Args:
        directory: the application's, where relative paths begin.
        home: the Rigelfile's; files outside of it need trust.

    Raises:
        Untrusted: one is elsewhere.
        UserError: one cannot be read, or they are too many or too large.
    """
    return collect(_read_each(options, directory, home), "", lambda path: path)


def check_local_files(
    options: OrchestrationOptions, directory: Path, home: Path
) -> Iterator[Problem]:
    """Yield what read_files would refuse; a path with a template waits."""
    return explain(_read_each(options, directory, home), "", "bad-file")


def _read_each(options: OrchestrationOptions, directory: Path, home: Path) -> Iterator[Use[Folder]]:
    named = (
        (("nodes", str(key), "files", str(at)), name)
        for key, node in options.nodes.items()
        for at, name in node.files.items()
    )
    return read_each(
        named, lambda name: read_folder(directory / name, home), _size, MOST_BYTES, TOO_LARGE
    )


def _size(folder: Folder) -> int:
    return sum(len(file.content) for file in folder.values())


def read_folder(path: Path, home: Path) -> Folder:
    """Return what is at a path. Raises as read_files does."""
    if not path.is_dir():
        return {"": _read_file(path, home)}
    names = sorted(_list_files(path))
    if not names:
        raise UserError(f"{path} is an empty folder", hint="remove it here, or add files")
    if len(names) > MOST_FILES:
        raise UserError(f"{path} has {len(names)} files, more than {MOST_FILES}", hint=LARGER)
    return {name.relative_to(path).as_posix(): _read_file(name, home) for name in names}


def _list_files(folder: Path) -> Iterator[Path]:
    """Yield what is in a folder and those below it, but for folders; links are not followed."""

    def refuse(error: OSError) -> NoReturn:
        raise _cannot_read(Path(error.filename), error)

    for top, folders, files in os.walk(folder, onerror=refuse):
        yield from (Path(top, name) for name in files)
        yield from (Path(top, name) for name in folders if Path(top, name).is_symlink())


def _read_file(path: Path, home: Path) -> LocalFile:
    try:
        content = read_bytes(path, home, MOST_BYTES, what="files", larger=LARGER)
    except OSError as error:
        raise _cannot_read(path, error) from error
    return LocalFile(content, executable=os.access(path, os.X_OK))


def _cannot_read(path: Path, error: OSError) -> UserError:
    hint = "write its path relative to the application's directory"
    return UserError(f"cannot read {path}: {error.strerror}", hint=hint)

"""Where built or downloaded files are kept, and how one process at a time works on something.

It exists because local clusters and images build what several commands may need at once. It is
independent of both.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rigel_k8s.errors import RigelK8sError


def cache_dir() -> Path:
    """Return the directory of built or downloaded files."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "rigel-k8s"


@contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold a lock file, which is removed afterwards.

    Raises:
        RigelK8sError: another process holds it, and `wait` is False.
    """
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("w")
        except (FileExistsError, FileNotFoundError):
            continue  # the last holder has just removed the directory
        with file:
            lock(file.fileno(), path, wait=wait)
            if not is_file(file.fileno(), path):
                continue  # the last holder has removed the file
            try:
                yield
            finally:
                path.unlink(missing_ok=True)
                with suppress(OSError):
                    path.parent.rmdir()
            return


def lock(descriptor: int, path: Path, *, wait: bool) -> None:
    """Lock an open file."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        raise RigelK8sError(
            f"another rigel process works on {path.stem}", hint="wait until it has ended"
        ) from error


def is_file(descriptor: int, path: Path) -> bool:
    """Return whether an open file is the one that a path names."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False

"""Where clusters keep what they know, and how one command at a time works on it."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rigel_k8s.errors import LocalClusterError

__all__ = ["LOCKS", "STATE", "boot_id", "cache_dir", "directory_of", "locked", "names"]

#: One directory a cluster in `clusters`, and what several clusters share.
STATE = Path("/var/lib/rigel-k8s")
LOCKS = Path("/run/rigel-k8s")


def cache_dir() -> Path:
    """Return the directory that keeps what was built or downloaded."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "rigel-k8s"


def directory_of(name: str) -> Path:
    """Return where a cluster keeps its state."""
    return STATE / "clusters" / name


def names() -> list[str]:
    """Return the names of all local clusters."""
    found = (STATE / "clusters").glob("*/cluster.json")
    return sorted(path.parent.name for path in found)


def boot_id() -> str:
    """Return what changes with every boot of this machine."""
    return Path("/proc/sys/kernel/random/boot_id").read_text().strip()


@contextmanager
def locked(path: Path, *, wait: bool = True) -> Iterator[None]:
    """Hold a lock file, which is gone afterwards.

    Raises:
        LocalClusterError: another process holds it, and `wait` is False.
    """
    while True:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = path.open("w")
        except (FileExistsError, FileNotFoundError):
            continue  # the last holder took the directory away just then
        with file:
            lock(file.fileno(), path, wait=wait)
            if not is_file(file.fileno(), path):
                continue  # the last holder took the file away
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
        raise LocalClusterError(
            f"another rigel is at work on {path.stem}", hint="wait until it has ended"
        ) from error


def is_file(descriptor: int, path: Path) -> bool:
    """Return whether an open file is the one that a path names."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.fstat(descriptor), path.stat())
    return False

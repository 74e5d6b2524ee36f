"""Files that a Rigelfile names, read with care: only regular ones, of a bounded size, beside it.

A path may lead anywhere, also by a symbolic link: to a pipe that never ends, or to a file whose
content must not be in a report or on a cluster.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

from rigel_k8s.errors import UserError
from rigel_k8s.system.trust import require_trust


def read_text(path: Path, directory: Path, most: int, *, what: str) -> str:
    """Return a file's text; arguments and errors as those of read_bytes.

    Raises:
        UnicodeDecodeError: it is not UTF-8.
    """
    return read_bytes(path, directory, most, what=what).decode("utf-8")


def read_bytes(
    path: Path, directory: Path, most: int, *, what: str, larger: str = "split it"
) -> bytes:
    """Return a file's content.

    Args:
        directory: where it must lie, unless the user trusts that directory.
        most: bytes.
        what: the option or file, for errors; larger: what to do with a larger one.

    Raises:
        Untrusted: it is elsewhere.
        UserError: it is too large, not a file, or its name is not possible.
        OSError: it cannot be read.
    """
    if "\0" in str(path):
        raise UserError(f"{what}: {str(path)!r} is not a valid file name")
    try:
        real = path.resolve()
    except RuntimeError:  # before Python 3.13
        raise UserError(f"{what}: {path} is a symbolic link that leads to itself") from None
    if not real.is_relative_to(directory.resolve()):
        require_trust(directory, f"{what}: {real} is outside the Rigelfile's directory")
    # Without O_NONBLOCK a named pipe would wait for a writer.
    with os.fdopen(os.open(real, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise UserError(f"{what}: {real} is not a regular file")
        content = file.read(most + 1)
    if len(content) > most:
        raise UserError(f"{what}: {real} has more than {most} bytes", hint=larger)
    return content

"""Which directories the user trusts: code in them may run, their Rigelfiles may read other files.

A Rigelfile can come from anyone. Looking at it must not run the code beside it, so the user names
the directory once, as with direnv or VS Code. The directory's real path and its owner are
remembered, not its content: a user who edits a job type, or pulls a commit, does not have to
confirm again.
"""

from __future__ import annotations

import json
import os
import shlex
import stat
import tempfile
from pathlib import Path

from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.system.cache import locked

FILE = "trusted.json"


class Untrusted(UserError):
    """Something that only a trusted directory may do; the hint says how to trust it."""


def state_file() -> Path:
    """Return the file of trusted directories; by its standard $XDG_STATE_HOME is absolute."""
    base = Path(os.environ.get("XDG_STATE_HOME") or "")
    base = base if base.is_absolute() else Path.home() / ".local" / "state"
    return base / "rigel-k8s" / FILE


def is_trusted(directory: Path) -> bool:
    """Return whether the user has trusted this very directory, and its owner is still the same.

    Raises:
        RigelK8sError: the file of trusted directories cannot be used.
    """
    real = directory.resolve()
    try:
        owner = real.stat().st_uid
    except OSError:
        return False
    return read_trusted().get(str(real)) == owner


def require_trust(directory: Path, what: str) -> None:
    """Refuse what needs trust: `what` describes what would happen, from where.

    Raises:
        Untrusted: the directory is not trusted.
    """
    if not is_trusted(directory):
        place = directory.resolve()
        raise Untrusted(
            f"{what}, and {place} is not trusted",
            hint=f"check what is in it, then: rigel trust {shlex.quote(str(place))}",
        )


def trust(directory: Path) -> bool:
    """Remember a directory; return whether it is new.

    Raises:
        UserError: it is not a directory, or other users may write into it.
        RigelK8sError: the file of trusted directories cannot be used.
    """
    real = directory.resolve()
    if not real.is_dir():
        raise UserError(f"{real} is not a directory", hint="rigel trust DIRECTORY")
    found = real.stat()
    if found.st_mode & stat.S_IWOTH:
        raise UserError(
            f"{real} cannot be trusted: every user of this machine may write into it",
            hint=f"chmod o-w {shlex.quote(str(real))}, or use another directory",
        )
    return _change(str(real), found.st_uid)


def distrust(directory: Path) -> bool:
    """Forget a directory; return whether it was trusted. Raises RigelK8sError as `trust` does."""
    return _change(str(directory.resolve()), None)


def read_trusted() -> dict[str, int]:
    """Return the owner of each trusted directory, by its path.

    Raises:
        RigelK8sError: the file cannot be read, or others may write it.
    """
    file = state_file()
    try:
        with file.open("rb") as opened:
            found = os.fstat(opened.fileno())
            if found.st_uid != os.geteuid() or found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                raise RigelK8sError(
                    f"{file} is not used: other users may write it",
                    hint=f"check what is in it, then chown {os.geteuid()} and chmod 600 that file",
                )
            content = json.load(opened)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise RigelK8sError(f"{file} cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise RigelK8sError(
            f"{file} is damaged: {error}", hint="remove it, and trust the directories again"
        ) from error
    owners = content.get("directories") if isinstance(content, dict) else None
    if not isinstance(owners, dict):
        raise RigelK8sError(f"{file} is damaged", hint="remove it, and trust the directories again")
    return {path: owner for path, owner in owners.items() if isinstance(owner, int)}


def _change(place: str, owner: int | None) -> bool:
    """Write a directory's owner, or remove the directory; return whether the file has changed."""
    file = state_file()
    try:
        file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with locked(file.with_suffix(".lock")):
            owners = read_trusted()
            if owners.get(place) == owner:
                return False
            others = {path: uid for path, uid in owners.items() if path != place}
            _write(file, others if owner is None else {**others, place: owner})
    except OSError as error:
        raise RigelK8sError(
            f"{error.filename or file} cannot be written: {error.strerror}",
            hint="set XDG_STATE_HOME to a directory that you can write into",
        ) from error
    return True


def _write(file: Path, owners: dict[str, int]) -> None:
    """Put a new file in place of the old one; only its owner can read it."""
    descriptor, name = tempfile.mkstemp(dir=file.parent, prefix=FILE)
    with os.fdopen(descriptor, "w", encoding="utf-8") as opened:
        json.dump({"directories": dict(sorted(owners.items()))}, opened, indent=2)
    Path(name).replace(file)

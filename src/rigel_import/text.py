"""Files that are imported, as text."""

from __future__ import annotations

from pathlib import Path

from rigel_k8s.errors import UserError


def read_text(file: Path) -> str:
    """Return the text of a file. Raises UserError if it cannot be read."""
    try:
        return file.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UserError(f"cannot read {file}: {reason}", hint="check the path") from error

"""Command lines and scalars as text."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

__all__ = ["text_of", "words"]


def words(command: str | Sequence[Any]) -> list[str]:
    """Return a command line as a list; text is split as a shell splits it (ValueError)."""
    return shlex.split(command) if isinstance(command, str) else [text_of(w) for w in command]


def text_of(value: Any) -> str:
    """Return a scalar as YAML writes it: true, not True."""
    return str(value).lower() if isinstance(value, bool) else str(value)

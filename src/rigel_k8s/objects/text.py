"""Command lines as text."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

from rigel_k8s.option_text import text_of

__all__ = ["words"]


def words(command: str | Sequence[Any]) -> list[str]:
    """Return a command line as a list; text is split as a shell splits it (ValueError)."""
    return shlex.split(command) if isinstance(command, str) else [text_of(w) for w in command]

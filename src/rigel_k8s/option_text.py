"""Option values as text: scalars as YAML writes them, and whether a template is still in them.

Every package that checks or uses options needs these; the templates themselves are in rigelfile/.
"""

from __future__ import annotations

import shlex
from functools import lru_cache
from typing import Any, TypeAlias

Scalar: TypeAlias = str | int | float | bool
#: Characters of a command line: Linux accepts no longer word, and splitting takes quadratic time.
LONGEST_COMMAND = 2**17


def text_of(value: Any) -> str:
    """Return a scalar as YAML writes it: true, not True."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def has_template(text: str) -> bool:
    """Return whether a text contains a template, so that its value is known only in a run."""
    return "{{" in text


def split_text(command: str) -> list[str]:
    """Return the words of a command line, as a shell splits it.

    Raises:
        ValueError: it is too long, or a quotation mark is not closed.
    """
    if len(command) > LONGEST_COMMAND:
        raise ValueError(f"it has more than {LONGEST_COMMAND} characters")
    return list(_split(command))


@lru_cache(maxsize=64)  # many checks look at the words of the same line
def _split(command: str) -> tuple[str, ...]:
    return tuple(shlex.split(command))

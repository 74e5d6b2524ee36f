"""Numbers that remember how they were written: 1.10 is a version for some and 1.1 for others.

They are floats and ints in every calculation; only `str()` returns the text of the Rigelfile.
"""

from __future__ import annotations

from typing import Any


class _Written:
    """A number whose text is not what Python would write."""

    raw: str

    def __str__(self) -> str:
        return self.raw


class WrittenFloat(_Written, float):
    """A float with its text."""


class WrittenInt(_Written, int):
    """An int with its text."""


def keep_text(value: Any, raw: str | None) -> Any:
    """Return a number that keeps its text if the text would be lost; other values unchanged."""
    if raw is None or isinstance(value, bool) or str(value) == raw:
        return value
    number: WrittenFloat | WrittenInt
    if isinstance(value, float):
        number = WrittenFloat(value)
    elif isinstance(value, int):
        number = WrittenInt(value)
    else:
        return value
    number.raw = raw
    return number

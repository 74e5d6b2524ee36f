"""Option values as text: scalars as YAML writes them, and whether a template is still in them.

Every package that checks or uses options needs these; the templates themselves are in rigelfile/.
"""

from __future__ import annotations

from typing import Any, TypeAlias

Scalar: TypeAlias = str | int | float | bool


def text_of(value: Any) -> str:
    """Return a scalar as YAML writes it: true, not True."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def has_template(text: str) -> bool:
    """Return whether a text contains a template, so that its value is known only in a run."""
    return "{{" in text

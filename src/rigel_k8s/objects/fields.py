"""How an option is declared: an attrs field that carries its own documentation."""

from __future__ import annotations

from typing import Any

import attrs

__all__ = ["needed", "option"]


def option(doc: str, default: Any = None) -> Any:
    """Return a field with its documentation; a mapping or list default is made anew each time."""
    if isinstance(default, dict | list):
        return attrs.field(factory=type(default), metadata={"doc": doc})
    return attrs.field(default=default, metadata={"doc": doc})


def needed(doc: str) -> Any:
    """Return a field that must be given."""
    return attrs.field(metadata={"doc": doc})

"""Text with places: what every value of a Rigelfile remembers of where it came from."""

from __future__ import annotations

from typing import Any

import attrs

__all__ = ["Node", "Source", "Span"]


@attrs.frozen
class Source:
    """A file's name as the user gave it, and its text."""

    name: str
    text: str


@attrs.frozen
class Span:
    """A place in a text; lines and columns start at 1, the end is exclusive."""

    line: int
    column: int
    end_line: int
    end_column: int


@attrs.frozen
class Node:
    """A YAML value with its place.

    Attributes:
        value: None, bool, int, float, str, or a list of Nodes, or a dict of key text to Node.
        span: the value's own place in the file (the place of use, for one that a template gave).
        raw: the text as written, for a scalar ("1.10" stays "1.10").
        key_span: the place of the key, for a value of a mapping.
        defined_at: the place of the var that gave the value, if a template gave it.
    """

    value: Any
    span: Span
    raw: str | None = None
    key_span: Span | None = None
    defined_at: Span | None = None

"""The little XML that DDS configuration files need, as lines."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Lines = Sequence[str]

ESCAPES = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;"})


def leaf(name: str, text: str) -> list[str]:
    """Return an element with a text."""
    return [f"<{name}>{text.translate(ESCAPES)}</{name}>"]


def element(name: str, *children: Lines, attributes: str = "") -> list[str]:
    """Return an element around others; without any, nothing."""
    inside = [f"  {line}" for child in children for line in child]
    return [f"<{name}{attributes}>", *inside, f"</{name}>"] if inside else []


def document(lines: Iterable[str]) -> str:
    """Return a whole file's text."""
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', *lines, ""])

"""Tables and pages of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def draw_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; a bar in a cell is escaped."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        f"| {' | '.join(cell.replace('|', '&#124;') for cell in row)} |" for row in lines
    )


def join_page(parts: Iterable[str]) -> str:
    """Return a page of parts, each a paragraph, a table or a heading."""
    return "\n\n".join(part.strip() for part in parts) + "\n"


def list_code(words: Iterable[str]) -> str:
    """Return words as code, with commas."""
    return ", ".join(f"`{word}`" for word in words)

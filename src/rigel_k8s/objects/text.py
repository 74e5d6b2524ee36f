"""Command lines, lists of names and counts as text."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from rigel_k8s.option_text import split_text, text_of

MOST = 6  # names in a line; `rigel status -o json` prints all


def split_words(command: str | Sequence[Any]) -> list[str]:
    """Return a command line as a list; text is split as a shell splits it (ValueError)."""
    return split_text(command) if isinstance(command, str) else [text_of(w) for w in command]


def join_words(names: Iterable[str]) -> str:
    """Return names as a phrase: a, b and c; a long list is cut."""
    found = list(names)
    if len(found) > MOST:
        return f"{', '.join(found[:MOST])} and {len(found) - MOST} more"
    return " and ".join(filter(None, [", ".join(found[:-1]), *found[-1:]]))


def plural(count: int, noun: str) -> str:
    """Return a count with its noun: 1 pod, 2 pods."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"

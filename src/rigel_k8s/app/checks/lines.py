"""Command lines in options: a text, or a list of words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rigel_k8s.app.parameters import ParameterOptions
from rigel_k8s.app.starting import split
from rigel_k8s.problems import Path, Problem


def check_line(
    options: ParameterOptions, path: Path, line: str | Sequence[Any] | None
) -> Iterator[Problem]:
    """Yield why a command line is not valid."""
    if line is None:
        return
    try:
        empty = not split(options, line)
    except ValueError as error:
        message = f"it cannot be split into words: {str(error).lower()}"
        yield Problem(path, message, "bad-command")
    else:
        if empty:
            yield Problem(path, "the command line is empty: remove it", "bad-command")

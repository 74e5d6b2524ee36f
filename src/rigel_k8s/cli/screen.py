"""A terminal's second screen, for what is shown again and again; the first stays as it was."""

from __future__ import annotations

import sys
from types import TracebackType

import click

ENTER = "\x1b[?1049h\x1b[?25l"
LEAVE = "\x1b[?25h\x1b[?1049l"
TOP = "\x1b[H\x1b[J"  # to the first line, without what is below it


class Screen:
    """Shows one text at a time; the last one stays in the terminal afterwards."""

    def __init__(self) -> None:
        self._text = ""

    def __enter__(self) -> Screen:
        self._write(ENTER)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._write(LEAVE)
        click.echo(self._text, nl=False)

    def show(self, text: str) -> None:
        """Replace what is shown."""
        self._text = text
        self._write(TOP)
        click.echo(text, nl=False)
        sys.stdout.flush()

    def _write(self, sequence: str) -> None:
        sys.stdout.write(sequence)  # not by click, which takes it for a color
        sys.stdout.flush()

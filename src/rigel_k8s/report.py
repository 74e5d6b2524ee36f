"""Where a long piece of work tells how it goes; only cli/ knows who shows it."""

from __future__ import annotations

from typing import Protocol


class Reporter(Protocol):
    """Takes what a user should see. All methods may be called from several threads at once."""

    def line(self, text: str) -> None:
        """Tell something that stays on the screen."""

    def warn(self, text: str) -> None:
        """Tell something that the user should look at; it stays on the screen."""

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Tell the present state of one thing: a row in a terminal, else a line per change."""

"""How long work reports its progress; only cli/ decides how it is shown."""

from __future__ import annotations

from typing import Protocol


class Reporter(Protocol):
    """Receives what a user should see. Several threads may call all methods at once."""

    def line(self, text: str) -> None:
        """Print a line that stays on the screen."""

    def warn(self, text: str) -> None:
        """Print a warning, which stays on the screen."""

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Show the present state of one thing: a row in a terminal, else a line per change.

        An empty state that is done ends the row, and nothing of it stays.
        """

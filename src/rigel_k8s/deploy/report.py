"""What a roll-out tells while it goes on; who shows it is not our business."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Reporter"]


class Reporter(Protocol):
    """Takes what a roll-out tells; its methods may be called from several threads."""

    def line(self, text: str) -> None:
        """Tell something that stays."""

    def warn(self, text: str) -> None:
        """Tell something that the user should look at."""

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Tell the present state of one thing."""

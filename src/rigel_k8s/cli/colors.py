"""Which colors are used, and when; imports nothing large, since every command needs it.

Each color is readable on white and on black: no yellow, no blue, nothing bright. Color never is
all that distinguishes two things.
"""

from __future__ import annotations

import os

#: What a user should look at, though nothing has failed.
WARNING = "magenta"
#: Of the names before lines of logs, each first as it is and then bold.
NAMES = ("cyan", "green", "magenta")
#: Terminals that cannot move their cursor.
DUMB = ("", "dumb", "unknown")


def choose_color(*, no_color: bool = False) -> bool | None:
    """Return whether to use colors; None if the output decides: a terminal has them, a file not."""
    if no_color or os.environ.get("NO_COLOR"):
        return False
    if os.environ.get("FORCE_COLOR"):
        return True
    return False if is_dumb() else None


def is_dumb() -> bool:
    """Return whether the terminal can only append."""
    return os.environ.get("TERM", "") in DUMB


def name_style(number: int) -> dict[str, str | bool]:
    """Return the style of the name of the first, second ... node, as click takes it."""
    return {"fg": NAMES[number % len(NAMES)], "bold": number // len(NAMES) % 2 == 1}

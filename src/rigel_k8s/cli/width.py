"""The width of an output in columns; imported before any command, so it imports nothing large."""

from __future__ import annotations

import os
import re
from typing import TextIO

#: Columns without a terminal: a file, a pipe, the log of a CI system.
WITHOUT_TERMINAL = 160
#: Characters of a cell, or of a name.
LONGEST = 500
#: What users copy from a text: a command in backquotes.
COMMAND = re.compile(r"`[^`\n]+`")
#: Replaces the spaces of a command while lines are made; no text contains it.
KEPT = "\ue000"


def find_room(stream: TextIO) -> int | None:
    """Return the columns of a stream's terminal, None if it has no limit, as a file."""
    return find_width(stream) if stream.isatty() else None


def find_width(stream: TextIO) -> int:
    """Return the columns of a stream's terminal."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or WITHOUT_TERMINAL
    except (OSError, ValueError):  # not a terminal, or not a file at all
        return WITHOUT_TERMINAL


def make_printable(text: str, most: int | None = LONGEST) -> str:
    """Return a text as one line, at most so long, without commands to a terminal.

    Names of a ROS graph are whatever a program has registered.
    """
    shown = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
    return shorten(shown, most or len(shown))


def shorten(text: str, width: int) -> str:
    """Return a text without its middle: names differ at their ends."""
    if len(text) <= width:
        return text
    begin = (width - 1) // 2
    return f"{text[:begin]}…{text[len(text) - (width - 1 - begin) :]}"


def wrap(text: str, stream: TextIO, indent: int = 0, margin: str = "") -> str:
    """Return a text for a stream: in a terminal, its lines end between words.

    Words longer than a line, such as addresses, stay whole. A command in backquotes stays on one
    line if it fits. The first line begins in the column `indent`, the
    others with the margin.
    """
    room = find_room(stream)
    if room is None:
        return text
    from textwrap import TextWrapper

    wrapper = TextWrapper(
        room, break_long_words=False, break_on_hyphens=False, replace_whitespace=False
    )

    def keep(command: re.Match[str]) -> str:
        return command[0].replace(" ", KEPT) if len(command[0]) <= room else command[0]

    lines: list[str] = []
    for line in COMMAND.sub(keep, text).split("\n"):
        wrapper.initial_indent = margin if lines else " " * indent
        wrapper.subsequent_indent = margin
        lines.append(wrapper.fill(line)[0 if lines else indent :])
    return "\n".join(lines).replace(KEPT, " ")


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

"""The level of log lines that come from the API server, as the stack's collector reads it for Loki.

It uses the same expressions (observability/manifests/lines.py), so that both give the same levels.
Pure text: independent of pods and Loki.
"""

from __future__ import annotations

import re

from rigel_k8s.observability.manifests import lines
from rigel_k8s.observability.names import LEVELS

FORMS = tuple(re.compile(form) for form in lines.LEVEL_FORMS)
GOES_ON = re.compile(lines.GOES_ON)
TRACEBACK = re.compile(lines.TRACEBACK)
HEAD = "Traceback (most recent call last):"
#: Other words for a level.
SAME = {"warning": "warn", "critical": "fatal", "trace": "debug"}


def level_of(line: str) -> str:
    """Return the level in a line: one of LEVELS, or "" if it has none."""
    for form in FORMS:
        if found := form.match(line):
            word = found["level"].lower()
            return SAME.get(word, word)
    return "error" if TRACEBACK.match(line) else ""


def at_least(level: str) -> frozenset[str]:
    """Return a level and those above it."""
    return frozenset(LEVELS[LEVELS.index(level) :])


class LevelReader:
    """Gives each line of one container its level: continuation lines have that of the first line.

    Continuation lines are blank and indented lines, and everything after a Python traceback's head
    up to its exception, with the exceptions that it was raised from. A traceback that does not
    follow a log line is an error, whatever was logged before it.
    """

    def __init__(self) -> None:
        self._level = ""
        self._open = False  # within a traceback, before its exception

    def level(self, line: str) -> str:
        """Return the next line's level."""
        indented = not line.strip() or line[:1].isspace()
        own = level_of(line)
        if own or not (indented or self._open or GOES_ON.match(line)):
            self._level = own
        self._open = HEAD in line or (self._open and indented)
        return self._level

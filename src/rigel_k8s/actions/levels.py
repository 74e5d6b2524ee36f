"""The level of log lines, read from how ROS 1, ROS 2 and what runs beside them write it.

Pure text: it knows neither pods nor Loki, whose collector reads levels by the same rules
(docs/observability.md), so that both ways give the same lines.
"""

from __future__ import annotations

import re

from rigel_k8s.manifests.observability.names import LEVELS

__all__ = ["LevelReader", "at_least", "level_of"]

WORDS = {
    "trace": "debug",
    "debug": "debug",
    "info": "info",
    "warn": "warn",
    "warning": "warn",
    "err": "error",
    "error": "error",
    "critical": "fatal",
    "fatal": "fatal",
}
COLOR = re.compile(r"\x1b\[[0-9;]*m")
#: Before the level may stand the process of `roslaunch` and `ros2 launch`: [talker-1].
START = r"\s*(?:\[[^\]\s]+-\d+\] *)?"
FORMS = tuple(
    re.compile(START + form, re.IGNORECASE)
    for form in (
        r"\[ *(debug|info|warn|warning|error|critical|fatal) *\]",  # ROS 1, ROS 2, their launches
        r"(debug|info|warning|error|critical|fatal):",  # logging, roslaunch
        r"\d{4}-\d\d-\d\d[T ][\d:.,]+(?:Z|[+-]\d\d:?\d\d)? +"
        r"(trace|debug|info|warn|warning|error)\b",  # Rust's tracing: zenohd
        r"(?:\d{4}-\d\d-\d\d [\d:.]+ )?\[\w+ (info|warning|error)\]",  # Fast DDS
    )
)
TRACEBACK = "Traceback (most recent call last):"
CHAINED = (
    "During handling of the above exception, another exception occurred:",
    "The above exception was the direct cause of the following exception:",
)


def level_of(line: str) -> str:
    """Return the level that a line says of itself: one of LEVELS, or "" where it says none."""
    plain = COLOR.sub("", line)
    for form in FORMS:
        if found := form.match(plain):
            return WORDS[found.group(1).lower()]
    return "error" if TRACEBACK in line else ""


def at_least(level: str) -> frozenset[str]:
    """Return a level and those above it."""
    return frozenset(LEVELS[LEVELS.index(level) :])


class LevelReader:
    """Gives each line of one container its level: those that go on have that of their beginning.

    Blank and indented lines go on, and after a Python traceback's head everything up to its
    exception, with the exceptions that it was raised from. A traceback that stands by itself is an
    error, whatever was logged before it.
    """

    def __init__(self) -> None:
        self._level = ""
        self._open = False  # within a traceback whose exception has not come
        self._chained = False  # the next traceback belongs to the one before

    def level(self, line: str) -> str:
        """Return the next line's level."""
        text = line.strip()
        goes_on = self._open or not text or line[:1].isspace() or text in CHAINED
        head = text == TRACEBACK and self._chained
        if not head and (own := level_of(line)):
            self._level = own
        elif not (head or goes_on):
            self._level = ""
        self._chained = text in CHAINED or (self._chained and not text)
        self._open = TRACEBACK in line or (self._open and (not text or line[:1].isspace()))
        return self._level

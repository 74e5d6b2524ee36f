"""Passes reports and errors of jobs on to Rigel: its log and its RigelError."""

from __future__ import annotations

import logging
import sys

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.jobs.job import JobReporter

#: The logger that Rigel configures with a handler and colours.
LOGGER = logging.getLogger("Rigel")


class LogReport:
    """A reporter that writes a line for each change into Rigel's log."""

    def __init__(self, name: str = "") -> None:
        self._prefix = f"{name}: " if name else ""
        self._states: dict[str, str] = {}

    def line(self, text: str) -> None:
        """Log something."""
        LOGGER.info("%s%s", self._prefix, text)

    def warn(self, text: str) -> None:
        """Log something that the user should look at."""
        LOGGER.warning("%s%s", self._prefix, text)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Log a state once."""
        if state and self._states.get(key) != state:
            self._states[key] = state
            LOGGER.info("%s%s: %s", self._prefix, key, state)

    def child(self, name: str) -> JobReporter:
        """Return a reporter whose lines begin with the name too."""
        return LogReport(f"{self._prefix}{name}")


def rigel_error(error: RigelK8sError) -> Exception:
    """Return Rigel's error with the text of ours; Rigel logs it and exits with 1."""
    lines = [error.message, *(f"  {detail}" for detail in error.details)]
    if error.hint:
        lines.append(f"hint: {error.hint}")
    cls: type[Exception] = getattr(sys.modules.get("rigel.exceptions"), "RigelError", RuntimeError)
    return cls("\n".join(lines))

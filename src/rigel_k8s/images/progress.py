"""What a build says, made short: its steps, and now and then a line of a long one."""

from __future__ import annotations

import re
import time
from collections.abc import Callable

__all__ = ["Steps", "step_of"]

#: Seconds between two lines of the same step.
PAUSE = 5.0

_LONGEST = 100
_PODMAN = re.compile(r"(?:\[(?!\d+/)([^\]]+)\] )?(?:\[\d+/\d+\] )?STEP (\d+/\d+): (.*)")
_BUILDX = re.compile(r"#\d+ \[(?:([^\]]*) )?(\d+/\d+)\] (.*)")
_BUILDX_OUTPUT = re.compile(r"#\d+ (?:\d+\.\d+ )?")


def step_of(line: str) -> str | None:
    """Return `3/7 RUN make` for the line that begins a step, None for any other."""
    match = _PODMAN.match(line) or _BUILDX.match(line)
    if match is None:
        return None
    stage, number, command = match.groups()
    words = " ".join(command.split())
    return _short(f"{stage} {number} {words}" if stage else f"{number} {words}")


class Steps:
    """Takes a build's lines and tells how far it is."""

    def __init__(
        self, tell: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._tell = tell
        self._clock = clock
        self._step = ""
        self._told = clock()

    def __call__(self, line: str) -> None:
        """Take one line of the build's output."""
        step = step_of(line)
        if step is not None:
            self._step = step
            self._say(step)
        elif self._step and self._clock() - self._told >= PAUSE:
            self._say(f"{self._step.split(' ', 1)[0]} {_short(_BUILDX_OUTPUT.sub('', line))}")

    def _say(self, state: str) -> None:
        self._told = self._clock()
        self._tell(state)


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"

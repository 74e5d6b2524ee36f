"""A build's output in short: its steps, an occasional line of a long one, its failure."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence

#: Seconds between two lines of the same step.
PAUSE = 5.0

#: How many lines of a failed step are shown: its first one and the last ones.
MOST_LINES = 200

_LONGEST = 100
_PODMAN = re.compile(r"(?:\[(?!\d+/)([^\]]+)\] )?(?:\[\d+/\d+\] )?STEP (\d+/\d+): (.*)")
_BUILDX = re.compile(r"#\d+ \[(?:([^\]]*) )?(\d+/\d+)\] (.*)")
_BUILDX_OUTPUT = re.compile(r"#\d+ (?:\d+\.\d+ )?")
_BUILDX_ERROR = re.compile(r"#(\d+) ERROR: ")
_BUILDX_BEFORE_END = re.compile("#|------$")
#: podman ends each step that succeeds with the layer that it made.
_PODMAN_LAYER = re.compile(r"--> [0-9a-f]{11,64}")
_PODMAN_END = re.compile("Error: ")


def step_of(line: str) -> str | None:
    """Return `3/7 RUN make` for the line that begins a step, None for any other."""
    match = _PODMAN.match(line) or _BUILDX.match(line)
    if match is None:
        return None
    stage, number, command = match.groups()
    words = " ".join(command.split())
    return _shorten(f"{stage} {number} {words}" if stage else f"{number} {words}")


class Steps:
    """Takes a build's lines and reports how far it is."""

    def __init__(
        self, on_state: Callable[[str], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._on_state = on_state
        self._clock = clock
        self._step = ""
        self._reported_at = clock()

    def __call__(self, line: str) -> None:
        """Take one line of the build's output."""
        step = step_of(line)
        if step is not None:
            self._step = step
            self._report(step)
        elif self._step and self._clock() - self._reported_at >= PAUSE:
            self._report(f"{self._step.split(' ', 1)[0]} {_shorten(_BUILDX_OUTPUT.sub('', line))}")

    def _report(self, state: str) -> None:
        self._reported_at = self._clock()
        self._on_state(state)


def failure(lines: Sequence[str]) -> list[str]:
    """Return what a failed build printed in the step that failed, and at its end.

    Steps of several platforms or stages run side by side; what others printed is left out. The
    result is empty if the build did not reach any step.
    """
    return list(_buildx_failure(lines) or _podman_failure(lines))


def _buildx_failure(lines: Sequence[str]) -> list[str]:
    """Each line begins with its step's number, except for those at the end.

    There buildx repeats the last few lines of the step between two lines of six dashes.
    """
    found: list[str] = []
    errors = filter(None, map(_BUILDX_ERROR.match, lines))
    for prefix in dict.fromkeys(f"#{error[1]} " for error in errors):
        heading, *others = (line for line in lines if line.startswith(prefix))
        # Both of these mark that the output of another step came between.
        output = (line for line in others if line not in (heading, f"{prefix}..."))
        found += _limit_lines([_BUILDX_OUTPUT.sub("", line) for line in (heading, *output)])
    if found:
        found += lines[_find_last(lines, _BUILDX_BEFORE_END) + 1 :]
    return found


def _podman_failure(lines: Sequence[str]) -> Iterator[str]:
    """A step begins with a line of its own, the end with one that quotes the instruction."""
    end = _find_last(lines, _PODMAN_END)
    steps: list[list[str]] = []
    for line in lines[:end]:
        if _PODMAN.match(line):
            steps.append([line])
        elif steps:
            steps[-1].append(line)
    if not steps:
        return
    quoted = set(re.findall(r'building at STEP "(.*)": ', "\n".join(lines[end:])))
    for step in [s for s in steps if _is_failed(s, quoted)] or steps[-1:]:
        yield from _limit_lines(step)
    yield from lines[end:]


def _is_failed(step: Sequence[str], quoted: set[str]) -> bool:
    match = _PODMAN.match(step[0])
    done = any(map(_PODMAN_LAYER.fullmatch, step))
    return match is not None and match[3] in quoted and not done


def _find_last(lines: Sequence[str], pattern: re.Pattern[str]) -> int:
    """Return the index of the last line that begins so; the number of lines if none does."""
    places = (number for number in reversed(range(len(lines))) if pattern.match(lines[number]))
    return next(places, len(lines))


def _limit_lines(step: list[str]) -> list[str]:
    left_out = len(step) - MOST_LINES
    if left_out <= 0:
        return step
    return [step[0], f"[{left_out} lines are left out here]", *step[left_out + 1 :]]


def _shorten(text: str) -> str:
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 1]}…"

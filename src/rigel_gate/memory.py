"""The state as events, where it outlives the gate: a file of the pod, an object of the cluster."""

from __future__ import annotations

import base64
import json
import zlib
from contextlib import suppress
from pathlib import Path
from typing import IO, Iterable

from rigel_gate.state import Event, State, check

#: Lines in the file after which it is rewritten.
LINES = 20000


class Journal:
    """The events in a file, each written before its cause is answered.

    The file survives the program but not the machine, so nothing waits for a disk.

    Args:
        path: in a directory that lives as long as the pod.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: IO[str] | None = None
        self._lines = 0

    def read(self) -> State | None:
        """Return the state that was kept, None if none was.

        Raises:
            OSError, ValueError: nothing in it can be read.
        """
        if not self._path.exists():
            return None
        if not self._path.is_file():
            raise ValueError(f"{self._path} is not a file")
        lines = self._path.read_bytes().splitlines()
        state = replay(lines)
        if lines and state.left_out == len(lines):
            raise ValueError("no line of it is an event")
        return state

    def begin(self, state: State) -> None:
        """Write a state; later events are added to it."""
        fresh = self._path.with_suffix(".new")
        self._close()
        with fresh.open("w", encoding="utf-8") as file:
            file.writelines(line_of(event) for event in state.events())
        fresh.replace(self._path)
        self._file = self._path.open("a", encoding="utf-8", buffering=1)
        self._lines = 0

    def keep(self, event: Event, state: State) -> None:
        """Write an event, which the state has already applied."""
        if self._file is None or self._lines >= LINES:
            self.begin(state)
            return
        try:
            self._file.write(line_of(event))
        except OSError:
            self._close()  # the next event writes everything
            raise
        self._lines += 1

    def _close(self) -> None:
        file, self._file = self._file, None
        if file is not None:
            with suppress(OSError):  # what could not be written before cannot be now
                file.close()


def line_of(event: Event) -> str:
    """Return an event as a line."""
    return json.dumps(event) + "\n"


def replay(lines: Iterable[str | bytes]) -> State:
    """Return the state that lines give, without those that are damaged or from another version."""
    state = State()
    for line in lines:
        try:
            event = json.loads(line)
            check(event)
            state.apply(event)
        except Exception:  # json's, expat's, too deep: whatever it is, it concerns this line alone
            state.left_out += 1
    return state


def compress(state: State) -> str:
    """Return a state as text for an object of the cluster."""
    text = "".join(line_of(event) for event in state.events())
    return base64.b64encode(zlib.compress(text.encode("utf-8"), 6)).decode("ascii")


def decompress(text: str) -> State:
    """Return the state of a text of `compress`; raises ValueError for another one."""
    try:
        return replay(zlib.decompress(base64.b64decode(text, validate=True)).splitlines())
    except (ValueError, zlib.error) as error:
        raise ValueError(f"this gate did not write it: {error}") from error

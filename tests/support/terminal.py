"""A program in a real terminal of a known size, and what is on its screen.

The screen understands what our programs write: text, line ends, carriage returns, colors, moves
by line, and a second screen. Anything else fails a test, so that a new control sequence is looked
at first.
"""

from __future__ import annotations

import errno
import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from .until import until

SEQUENCE = re.compile(r"\x1b\[(\??)([0-9;]*)([A-Za-z])")
COLUMNS, ROWS = 80, 24


class Terminal:
    """A program, and everything that it has written."""

    def __init__(self, child: subprocess.Popen[bytes], leader: int, columns: int) -> None:
        self._child = child
        self._leader = leader
        self._columns = columns
        self._bytes = b""

    @property
    def process(self) -> int:
        """The program's process and process group."""
        return self._child.pid

    @property
    def text(self) -> str:
        """Everything that was written, with its control sequences."""
        return self._bytes.decode("utf-8", "replace")

    def press(self, keys: str) -> None:
        """Type something."""
        os.write(self._leader, keys.encode())

    def until(self, words: str, seconds: float = 30) -> None:
        """Read until words were written."""
        deadline = time.monotonic() + seconds
        while words not in self.text:
            assert time.monotonic() < deadline, f"no {words!r} in {self.text!r}"
            assert self._read(0.1), f"ended without {words!r}: {self.text!r}"

    def until_asleep(self) -> None:
        """Wait until the program waits, for a key as a rule.

        Python sees a signal that comes just before a system call only when that has ended.
        """
        stat = Path(f"/proc/{self.process}/stat")
        until(lambda: stat.read_text().rpartition(") ")[2][0] == "S", "sleep", every=0.01)

    def end(self, seconds: float = 60) -> int:
        """Read until the program ends, and return its exit code, negative for a signal."""
        deadline = time.monotonic() + seconds
        while self._read(0.1):
            assert time.monotonic() < deadline, f"does not end: {self.text!r}"
        os.close(self._leader)
        return self._child.wait(seconds)

    def screen(self) -> list[str]:
        """Return the lines, also those that have scrolled away."""
        return [line.rstrip() for line in show(self.text, self._columns)]

    def _read(self, seconds: float) -> bool:
        """Read what there is; False at the end."""
        if not select.select([self._leader], [], [], seconds)[0]:
            return True
        try:
            part = os.read(self._leader, 65536)
        except OSError as error:
            if error.errno != errno.EIO:  # how Linux reports the end
                raise
            part = b""
        self._bytes += part
        return bool(part)


def open_terminal(
    words: Sequence[str],
    environment: Mapping[str, str],
    *,
    columns: int = COLUMNS,
    directory: Path | None = None,
) -> Terminal:
    """Start a program as a user's shell does: in the foreground of a terminal of its own."""
    # If they are set, they would be the size instead of the terminal's.
    inherited = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    leader, follower = pty.openpty()
    fcntl.ioctl(follower, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, columns, 0, 0))

    child = subprocess.Popen(
        [*_CONTROL, *words],
        stdin=follower,
        stdout=follower,
        stderr=follower,
        cwd=directory,
        start_new_session=True,
        env={**inherited, "TERM": "xterm-256color", **environment},
    )
    os.close(follower)
    return Terminal(child, leader, columns)


#: Makes standard input the controlling terminal, so that Ctrl-C reaches the program, which must not
#: inherit that signals are ignored: what a shell starts in the background does, and under `nohup`.
_CONTROL = (
    "python3",
    "-c",
    "import fcntl, os, signal, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0);"
    " [signal.signal(number, signal.SIG_DFL) for number in (signal.SIGINT, signal.SIGHUP)];"
    " os.execvp(sys.argv[1], sys.argv[1:])",
)


def show(text: str, columns: int) -> list[str]:
    """Return the lines that a terminal shows after a text, as wide as its columns."""
    screen = _Screen(columns)
    for part, sequence in _split(text):
        screen.write(part)
        if sequence:
            screen.obey(sequence)
    return ["".join(line) for line in screen.lines]


def _split(text: str) -> Iterator[tuple[str, re.Match[str] | None]]:
    begin = 0
    for found in SEQUENCE.finditer(text):
        yield text[begin : found.start()], found
        begin = found.end()
    yield text[begin:], None


class _Screen:
    def __init__(self, columns: int) -> None:
        self._columns = columns
        self.lines: list[list[str]] = [[]]
        self._row = self._column = 0
        self._first: tuple[list[list[str]], int, int] | None = None

    def write(self, text: str) -> None:
        for one in text:
            if one == "\r":
                self._column = 0
            elif one == "\n":
                self._move(self._row + 1)
            elif one == "\b":
                self._column = max(0, self._column - 1)
            else:
                assert one.isprintable(), f"{one!r} in {text!r}"
                self._put(one)

    def obey(self, sequence: re.Match[str]) -> None:
        private, numbers, letter = sequence.groups()
        count = int(numbers) if numbers.isdigit() else 1
        line = self.lines[self._row]
        if private and numbers == "1049":
            self._switch(second=letter == "h")
        elif self._first and not numbers and letter == "H":
            self._row = self._column = 0
        elif letter == "J" and not numbers:
            del line[self._column :]
            del self.lines[self._row + 1 :]
        elif letter == "A":
            self._move(max(0, self._row - count))
        elif letter == "K" and numbers == "2":
            line.clear()
        elif letter == "K":
            del line[self._column :]
        else:
            assert letter == "m" or (private and numbers in ("25", "2026")), sequence[0]

    def _switch(self, *, second: bool) -> None:
        """Begin on an empty screen, or go back to the first one."""
        if second:
            self._first = self.lines, self._row, self._column
            self.lines, self._row, self._column = [[]], 0, 0
        elif self._first:
            self.lines, self._row, self._column = self._first
            self._first = None

    def _put(self, one: str) -> None:
        if self._column == self._columns:
            self._column = 0
            self._move(self._row + 1)
        line = self.lines[self._row]
        line += [" "] * (self._column + 1 - len(line))
        line[self._column] = one
        self._column += 1

    def _move(self, row: int) -> None:
        self._row = row
        while len(self.lines) <= row:
            self.lines.append([])

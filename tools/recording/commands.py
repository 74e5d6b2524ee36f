"""Runs commands in a terminal of a fixed width, and records their output."""

from __future__ import annotations

import fcntl
import os
import pty
import shlex
import struct
import subprocess
import sys
import termios
from pathlib import Path

import attrs

COLUMNS = 100


@attrs.frozen
class Run:
    """A command as it is shown, and its output with the terminal's colors."""

    command: str
    output: str


def run(command: str, directory: Path, *, context: str, live: bool = True, code: int = 0) -> Run:
    """Run a command of rigel; one that is not live prints each change as a line.

    Raises:
        RuntimeError: its exit code is another one; with its output.
    """
    words = shlex.split(command)
    if words[0] != "rigel":
        raise ValueError(f"not a command of rigel: {command}")
    words = [sys.executable, "-m", "rigel_k8s", "--context", context, *words[1:]]
    reader, writer = pty.openpty() if live else os.pipe()
    if live:
        fcntl.ioctl(writer, termios.TIOCSWINSZ, struct.pack("HHHH", 24, COLUMNS, 0, 0))
    with subprocess.Popen(
        words,
        cwd=directory,
        env={**os.environ, "COLUMNS": str(COLUMNS), "TERM": "xterm-256color"},
        stdout=writer,
        stderr=writer,
    ) as process:
        os.close(writer)
        output = _read(reader)
    if process.returncode != code:
        raise RuntimeError(f"{command} ended with {process.returncode}:\n{output}")
    return Run(command, output.replace("\r\n", "\n"))


def _read(reader: int) -> str:
    """Return everything until the other end is closed, which a terminal reports as an error."""
    parts: list[bytes] = []
    with os.fdopen(reader, "rb", buffering=0) as stream:
        try:
            while part := stream.read(65536):
                parts.append(part)
        except OSError:
            pass
    return b"".join(parts).decode("utf-8", "replace")

"""Commands that go on until Ctrl-C, for tests that read what they say meanwhile."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import threading
from collections.abc import Sequence


class Background:
    """A command that goes on, and its output so far; `with` interrupts it in the end."""

    def __init__(self, command: Sequence[str]) -> None:
        self._process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()

    def __enter__(self) -> Background:
        return self

    def __exit__(self, *_: object) -> None:
        self.interrupt()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.lines.append(line.rstrip("\n"))

    def found(self, pattern: str) -> re.Match[str] | None:
        """Return the first line that matches."""
        return next((m for line in list(self.lines) if (m := re.search(pattern, line))), None)

    def interrupt(self, number: int = signal.SIGINT) -> int:
        """Press Ctrl-C, or send another signal, and return the exit code."""
        if self._process.poll() is None:
            self._process.send_signal(number)
        code = self._process.wait(timeout=300)
        self._reader.join()
        assert self._process.stdout is not None
        self._process.stdout.close()
        return code

"""The user's own terminal while it belongs to a command in a pod."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any, BinaryIO


class Terminal:
    """A terminal in raw mode: keys are passed to the command unread, its size is reported.

    Used as a context, which restores the terminal's own mode.
    """

    def __init__(self, stream: BinaryIO, resized: Callable[[os.terminal_size], None]):
        self.number = stream.fileno()
        self.resized = resized
        self.mode: list[Any] | None = None
        self.handler: Any = None

    def __enter__(self) -> Terminal:
        if os.isatty(self.number) and sys.platform != "win32":
            import termios
            import tty

            self.mode = termios.tcgetattr(self.number)
            tty.setraw(self.number)
            self.follow_size()
        return self

    def __exit__(self, *_: object) -> None:
        if self.mode is not None and sys.platform != "win32":
            import termios

            termios.tcsetattr(self.number, termios.TCSADRAIN, self.mode)
        if self.handler is not None:
            signal.signal(signal.SIGWINCH, self.handler)

    def follow_size(self) -> None:
        """Report the size now and whenever it changes."""
        self.report_size()
        if threading.current_thread() is threading.main_thread():
            self.handler = signal.signal(signal.SIGWINCH, lambda *_: self.report_size())

    def report_size(self) -> None:
        """Report the size now."""
        self.resized(os.get_terminal_size(self.number))

"""SIGINT and SIGTERM of the command line; it imports almost nothing, since it runs first.

The first signal lets work end in good order, the second ends the process. The exit code depends on
which of the two came first, so it is noted here.
"""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from types import FrameType

NUMBERS = (signal.SIGINT, signal.SIGTERM)
Handler = Callable[[int, FrameType | None], None]

_received: list[int] = []
#: Whether the cursor of the terminal may stand behind the ^C that it has written.
_behind_echo = False


def note(number: int) -> None:
    """Remember a signal."""
    global _behind_echo
    _received.append(number)
    _behind_echo = number == signal.SIGINT


def begin_line() -> None:
    """Move the cursor of standard error to a new line if it is behind a ^C."""
    if _behind_echo and sys.stderr.isatty():
        sys.stderr.write("\n")
    forget_echo()


def forget_echo() -> None:
    """Note that no ^C is left in the cursor's line."""
    global _behind_echo
    _behind_echo = False


def exit_code() -> int:
    """Return the exit code of a process that was interrupted: 130, or 143 after SIGTERM."""
    return 128 + (_received[0] if _received else signal.SIGINT)


def end_at_once(text: str) -> None:
    """End the process without waiting for anything; one line says what that means."""
    show_cursor = "\n\x1b[?25h" if sys.stderr.isatty() else ""
    os.write(2, f"{show_cursor}error: {text}\n".encode())
    os._exit(exit_code())


def leave_early(number: int, _: FrameType | None) -> None:
    """End a process that has only imported modules."""
    note(number)
    end_at_once("interrupted before anything was done")


def raise_interrupt(number: int, _: FrameType | None) -> None:
    """Interrupt the main thread, which has no work yet that could end in good order.

    A second signal ends the process. It would interrupt the clean-up after the first, and could
    leave a lock behind that a thread waits for.
    """
    is_second = bool(_received)
    note(number)
    if is_second:
        end_at_once("interrupted twice")
    raise KeyboardInterrupt


def handle(handler: Handler) -> None:
    """Handle both signals, except one that the process's parent has set to be ignored (nohup)."""
    for number in NUMBERS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, handler)

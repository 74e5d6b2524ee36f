"""Ctrl-C and SIGTERM as a call that may come at any moment; it knows no job."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

#: The handlers that nobody has set on purpose; others are left alone.
USUAL: Mapping[signal.Signals, Any] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}


@contextmanager
def interruptions(tell: Callable[[], None]) -> Iterator[None]:
    """Call `tell` for each Ctrl-C and SIGTERM, in the main thread, between any two instructions.

    So it must be reentrant, as SimpleQueue.put is. Handlers that the program has set itself stay,
    and outside the main thread nothing is changed.
    """
    in_main = threading.current_thread() is threading.main_thread()
    ours = [n for n, usual in USUAL.items() if in_main and signal.getsignal(n) is usual]
    for number in ours:
        signal.signal(number, lambda *_: tell())
    try:
        yield
    finally:
        for number in ours:
            signal.signal(number, USUAL[number])

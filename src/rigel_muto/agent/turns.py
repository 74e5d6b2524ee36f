"""Work that is done one piece at a time, and of which only the newest counts."""

from __future__ import annotations

import ctypes
import gc
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol


class Work(Protocol):
    """A piece of work."""

    def run(self) -> None:
        """Do it; return soon after `stop`. Raises nothing."""

    def stop(self) -> None:
        """End it soon, or never begin: a newer piece waits, or the program ends."""


class Turns:
    """A thread that does the newest piece of work, and calls `idle` while it has none.

    Args:
        idle: called about every `interval` seconds while no work is done; raises nothing.
    """

    def __init__(self, idle: Callable[[], None], interval: float) -> None:
        self._idle = idle
        self._interval = interval
        self._changed = threading.Condition()
        self._next: Work | None = None
        self._running: Work | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._work, name="turns", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def put(self, work: Work) -> None:
        """Do this next: stop the present work, and the waiting one, which never begins."""
        with self._changed:
            if self._next is not None:
                self._next.stop()
            self._next = work
            self._stop_running()

    def close(self, patience: float) -> None:
        """Stop the present work, and wait for its end for some seconds."""
        with self._changed:
            self._closed = True
            self._stop_running()
        self._thread.join(patience)

    def _stop_running(self) -> None:
        if self._running is not None:
            self._running.stop()
        self._changed.notify()

    def _work(self) -> None:
        while True:
            with self._changed:
                if self._next is None and not self._closed:
                    self._changed.wait(self._interval)
                if self._closed:
                    return
                self._running, self._next = self._next, None
                work = self._running
            (work.run if work else self._idle)()
            with self._changed:
                self._running = None
            if work:
                work = None
                free_memory()


def free_memory() -> None:
    """Return to the system what work has left.

    It leaves cycles with connections in them, of whose memory Python knows nothing: it would
    collect them after hundreds of mebibytes. And glibc keeps what threads that have ended freed.
    """
    gc.collect()
    with suppress(AttributeError, OSError):  # another C library has no malloc_trim
        ctypes.CDLL(None).malloc_trim(0)

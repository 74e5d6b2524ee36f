"""Cancellation that reaches everything started under it; independent of jobs."""

from __future__ import annotations

import threading
from collections.abc import Callable


class CancelScope:
    """A part of a run that can be stopped: sets `cancelled`, also of all its parts."""

    def __init__(self) -> None:
        self.cancelled = threading.Event()
        self._parts: list[CancelScope] = []
        self._callbacks: list[Callable[[], None]] = []
        self._lock = threading.RLock()  # cancel() may come from a signal handler

    def on_cancel(self, notify: Callable[[], None]) -> None:
        """Call a function when this is cancelled; at once if it is already."""
        with self._lock:
            self._callbacks.append(notify)
            cancelled = self.cancelled.is_set()
        if cancelled:
            notify()

    def part(self) -> CancelScope:
        """Return a new part; if the scope is already cancelled, so is the part."""
        part = CancelScope()
        with self._lock:
            self._parts.append(part)
            if self.cancelled.is_set():
                part.cancelled.set()
        return part

    def cancel(self) -> None:
        """Stop this and all parts."""
        with self._lock:
            first = not self.cancelled.is_set()
            self.cancelled.set()
            parts, callbacks = tuple(self._parts), tuple(self._callbacks)
        for notify in callbacks if first else ():
            notify()
        for part in parts:
            part.cancel()

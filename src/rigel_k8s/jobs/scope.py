"""Cancellation that reaches everything started under it; it knows no job."""

from __future__ import annotations

import threading
from collections.abc import Callable


class CancelScope:
    """A part of a run that can be stopped: `cancelled` is set, and that of every part of it."""

    def __init__(self) -> None:
        self.cancelled = threading.Event()
        self._parts: list[CancelScope] = []
        self._tells: list[Callable[[], None]] = []
        self._lock = threading.RLock()  # cancel() may come from a signal handler

    def on_cancel(self, tell: Callable[[], None]) -> None:
        """Call a function when this is cancelled; at once if it is already."""
        with self._lock:
            self._tells.append(tell)
            cancelled = self.cancelled.is_set()
        if cancelled:
            tell()

    def part(self) -> CancelScope:
        """Return a new part; one of a scope that is cancelled already is born cancelled."""
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
            parts, tells = tuple(self._parts), tuple(self._tells)
        for tell in tells if first else ():
            tell()
        for part in parts:
            part.cancel()

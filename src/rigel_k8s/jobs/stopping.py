"""What stops a run: scopes that can be cancelled, and Ctrl-C and SIGTERM as calls."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rigel_k8s import signals

#: The default handlers; handlers that a program has set are not replaced.
USUAL = (signal.default_int_handler, signal.SIG_DFL, signals.raise_interrupt)


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


@contextmanager
def interruptions(notify: Callable[[], None]) -> Iterator[None]:
    """Call `notify` for each Ctrl-C and SIGTERM, in the main thread, between any two instructions.

    So it must be reentrant, as SimpleQueue.put is. Handlers that the program has set itself stay,
    and outside the main thread nothing is changed.
    """
    in_main = threading.current_thread() is threading.main_thread()
    before = {n: signal.getsignal(n) for n in signals.NUMBERS if in_main}
    ours = {number: usual for number, usual in before.items() if usual in USUAL}

    def handle(number: int, _: object) -> None:
        signals.note(number)
        notify()

    for number in ours:
        signal.signal(number, handle)
    try:
        yield
    finally:
        for number, usual in ours.items():
            signal.signal(number, usual)

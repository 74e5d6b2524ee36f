"""Ctrl-C and SIGTERM as a call that may come at any moment; independent of jobs."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rigel_k8s import signals

#: The default handlers; handlers that a program has set are not replaced.
USUAL = (signal.default_int_handler, signal.SIG_DFL, signals.raise_interrupt)


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

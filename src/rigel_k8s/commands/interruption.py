"""Ctrl-C as an event for work that ends cleanly; a second one ends at once."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from rigel_k8s import signals
from rigel_k8s.jobs.interruption import interruptions

TWICE = (
    "interrupted twice, stopped without waiting; run the same command again to complete its work"
)


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Give an event that Ctrl-C or SIGTERM sets; the second one ends the process."""
    cancel = threading.Event()
    calls = itertools.count()

    def notify() -> None:
        if next(calls):
            signals.end_at_once(TWICE)
        # Event.set takes a lock that the interrupted main thread may hold in this very moment.
        threading.Thread(target=cancel.set).start()

    with interruptions(notify):
        yield cancel

"""Several requests at once, and streams that end on request."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Protocol, TypeVar

WIDTH = 8  # requests at once: more only queue in the server and in this interpreter
LOOK = 0.2  # seconds between two looks at a cancel event, and for signals
T = TypeVar("T")
R = TypeVar("R")


class Abortable(Protocol):
    """An object that another thread may end."""

    def abort(self) -> None:
        """End it."""


def parallel(function: Callable[[T], R], items: Iterable[T], *, width: int = WIDTH) -> Sequence[R]:
    """Call a function for all items on up to `width` threads; results in the order of the items.

    All items are tried. Then the first error in their order is raised.
    """
    todo = list(items)
    if len(todo) < 2:
        return [function(item) for item in todo]
    with ThreadPoolExecutor(min(width, len(todo))) as pool:
        futures = [pool.submit(function, item) for item in todo]
        try:
            # A signal that comes just before the main thread waits, or to another thread, does not
            # wake it: it must wake by itself.
            while wait(futures, timeout=LOOK).not_done:
                pass
        except BaseException:  # interrupted: nothing more is started
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [future.result() for future in futures]


@contextmanager
def aborting(stream: Abortable, cancel: threading.Event | None) -> Iterator[None]:
    """Abort a stream soon after `cancel` is set, and when the context ends."""
    over = threading.Event()

    def look() -> None:
        while not over.wait(LOOK):
            if cancel is not None and cancel.is_set():
                stream.abort()
                return

    if cancel is not None:
        threading.Thread(target=look, daemon=True).start()
    try:
        yield
    finally:
        over.set()
        stream.abort()

"""Several requests at once: their order, their errors, and what an interruption leaves."""

from __future__ import annotations

import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from rigel_k8s.system.threads import parallel
from tests.support.until import until


def test_parallel_keeps_the_order_and_tries_all() -> None:
    """Results in order; the first error is raised after everything has been tried."""
    assert list(parallel(lambda n: n * 2, range(50))) == [n * 2 for n in range(50)]
    done: list[int] = []
    lock = threading.Lock()

    def work(number: int) -> None:
        with lock:
            done.append(number)
        if number in (3, 7):
            raise ValueError(number)

    with pytest.raises(ValueError, match="3"):
        parallel(work, range(20))
    assert sorted(done) == list(range(20))


def test_a_signal_that_does_not_wake_the_main_thread_is_seen_all_the_same() -> None:
    """As one that comes between the last look and the wait: Ctrl-C would wait for the results."""
    seen, both = threading.Event(), threading.Barrier(2, timeout=30)

    def work(number: int) -> bool:
        both.wait()
        if number == 0:
            until(lambda: waits_in(threading.main_thread(), "wait"), "the main thread to wait")
            signal.raise_signal(signal.SIGUSR1)  # to this thread
        return seen.wait(30)

    before = signal.signal(signal.SIGUSR1, lambda *_: seen.set())
    try:
        assert parallel(work, range(2)) == [True, True]
    finally:
        signal.signal(signal.SIGUSR1, before)


def waits_in(thread: threading.Thread, function: str) -> bool:
    """Return whether a thread is in a function of this name, so that its next step is far away."""
    frame = sys._current_frames().get(thread.ident or 0)
    return frame is not None and frame.f_code.co_name == function


def test_an_interruption_begins_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """What runs is waited for: afterwards nothing goes on behind the caller's back."""
    begun: list[int] = []
    two, go_on = threading.Barrier(3), threading.Event()

    class Pool(ThreadPoolExecutor):
        def shutdown(self, wait: bool = True, **words: Any) -> None:  # noqa: FBT001, FBT002
            if wait:
                go_on.set()
            super().shutdown(wait, **words)

    def work(number: int) -> None:
        begun.append(number)
        two.wait(60)
        assert go_on.wait(60)

    def interrupt(*_: Any, **__: Any) -> None:
        two.wait(60)
        raise KeyboardInterrupt

    monkeypatch.setattr("rigel_k8s.system.threads.wait", interrupt)
    monkeypatch.setattr("rigel_k8s.system.threads.ThreadPoolExecutor", Pool)
    with pytest.raises(KeyboardInterrupt):
        parallel(work, range(20), width=2)
    assert go_on.is_set()
    assert sorted(begun) == [0, 1]

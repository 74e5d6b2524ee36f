"""Several requests at once: their order, their errors, and what an interruption leaves."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from rigel_k8s.system.threads import parallel


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

    def interrupt(_: Any) -> None:
        two.wait(60)
        raise KeyboardInterrupt

    monkeypatch.setattr("rigel_k8s.system.threads.wait", interrupt)
    monkeypatch.setattr("rigel_k8s.system.threads.ThreadPoolExecutor", Pool)
    with pytest.raises(KeyboardInterrupt):
        parallel(work, range(20), width=2)
    assert go_on.is_set()
    assert sorted(begun) == [0, 1]

"""One piece of work at a time."""

from __future__ import annotations

import gc
import weakref

from rigel_muto.agent.turns import Turns
from tests.support.until import until


class Cycle:
    """What only the garbage collector frees."""

    def __init__(self) -> None:
        self.own = self


class Work:
    """Leaves a cycle behind."""

    def __init__(self) -> None:
        self.left: weakref.ref[Cycle] | None = None

    def run(self) -> None:
        self.left = weakref.ref(Cycle())

    def stop(self) -> None:
        """Nothing waits for it."""


def test_what_work_leaves_is_freed_at_its_end() -> None:
    """Connections of a deploy are in cycles; a thousand deploys had a gibibyte of them."""
    turns, work = Turns(lambda: None, 60.0), Work()
    gc.disable()
    try:
        turns.start()
        turns.put(work)
        until(lambda: work.left is not None and work.left() is None, "the end of the cycle", 60)
    finally:
        gc.enable()
        turns.close(10)

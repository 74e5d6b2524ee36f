"""The one way in which tests wait."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def until(
    condition: Callable[[], T],
    what: str,
    seconds: float = 60,
    *,
    every: float = 0.1,
    despite: tuple[type[Exception], ...] = (),
    last_words: Callable[[], object] | None = None,
) -> T:
    """Return the first true answer of a condition; fail where none comes in time.

    Args:
        what: what is waited for, for the failure: "a ready pod".
        every: seconds between two looks.
        despite: errors of the condition that mean "not yet".
        last_words: what the failure adds, asked for at the end.
    """
    deadline = time.monotonic() + seconds
    while True:
        problem = None
        try:
            if answer := condition():
                return answer
        except despite as error:
            problem = error
        if time.monotonic() > deadline:
            more = (last_words and last_words()) or ""
            raise AssertionError(f"no {what} within {seconds:g} s {more}".strip()) from problem
        time.sleep(every)

"""jinja2's sandbox, and what keeps an expression from taking a whole machine.

jinja2 shields Python from an expression, but `"a" * 10**9` fills the memory, and a regular
expression may take for ever. The kernel stops both: a timer counts the processor's time, which all
expressions of a file share, and a limit of the address space refuses what is too large. Signals
reach the main thread only, where files of unknown origin are checked and rendered. In other
threads, where Rigel 0.3 runs a file, the time is looked at before each expression.
"""

from __future__ import annotations

import re
import resource
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from time import thread_time
from typing import Any

import attrs
from jinja2 import Environment, StrictUndefined
from jinja2.sandbox import ImmutableSandboxedEnvironment

from rigel_k8s.rigelfile.limits import (
    EXPRESSION_SECONDS,
    LONGEST_EXPRESSION,
    MOST_MEMORY,
    MOST_VALUES,
)

#: Filters for HTML, for debugging, and those whose result differs from run to run.
LEFT_OUT = frozenset(
    ("attr", "e", "escape", "forceescape", "pprint", "random", "safe", "striptags", "urlize")
    + ("wordwrap", "xmlattr")
)
#: Linux' numbers about this process; the first one is its address space in pages.
STATM = Path("/proc/self/statm")
#: Seconds until a signal that something swallowed is sent again.
AGAIN = 0.2


class TooLong(Exception):
    """The expressions of a file take more time than they may."""


@attrs.define
class Budget:
    """What the expressions of one file may still take, in seconds of the processor."""

    seconds: float = EXPRESSION_SECONDS

    @contextmanager
    def spend(self) -> Iterator[None]:
        """Limit the time and the memory of one expression.

        Raises:
            TooLong: nothing is left.
            MemoryError: it needs too much memory.
        """
        if self.seconds <= 0:
            raise TooLong
        began = thread_time()
        try:
            if threading.current_thread() is threading.main_thread():
                with _limit_time(self.seconds), _limit_memory():
                    yield
            else:
                yield
        finally:
            self.seconds -= thread_time() - began


@contextmanager
def _limit_time(seconds: float) -> Iterator[None]:
    def stop(*_: object) -> None:
        raise TooLong

    previous = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, AGAIN)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, previous or signal.SIG_DFL)


@contextmanager
def _limit_memory() -> Iterator[None]:
    if not STATM.exists():
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    now = int(STATM.read_text("ascii").split()[0]) * resource.getpagesize()
    limit = now + MOST_MEMORY
    if soft != resource.RLIM_INFINITY:
        limit = min(limit, soft)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def run(text: str, context: Mapping[str, Any], budget: Budget) -> Any:
    """Return what an expression gives, as plain data.

    Raises:
        TooLong: it takes too long.
        Exception: any error of jinja2 or of the calculation.
    """
    if len(text) > LONGEST_EXPRESSION:
        raise ValueError(f"an expression has at most {LONGEST_EXPRESSION} characters")
    with budget.spend():
        return _materialise(_compile(text)(**context), iter(range(MOST_VALUES)))


def _materialise(value: Any, room: Iterator[int]) -> Any:
    """Return a lazy result as a list, and those in it; `room` has one entry for each value."""
    if next(room, None) is None:
        raise ValueError(f"a result has at most {MOST_VALUES} values")
    if isinstance(value, str | int | float | StrictUndefined) or value is None:
        return value
    if isinstance(value, Mapping):
        return {key: _materialise(item, room) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [_materialise(item, room) for item in value]
    return value


@lru_cache(maxsize=512)
def _compile(text: str) -> Callable[..., Any]:
    return environment().compile_expression(text, undefined_to_none=False)


@lru_cache(maxsize=1)
def environment() -> Environment:
    """Return the environment of all expressions."""
    found = ImmutableSandboxedEnvironment(undefined=StrictUndefined, optimized=False)
    found.globals = {"range": found.globals["range"], "dict": dict}
    found.filters = {name: work for name, work in found.filters.items() if name not in LEFT_OUT}
    found.filters["regex_replace"] = _regex_replace
    return found


def _regex_replace(
    value: Any,
    pattern: str,
    replacement: str = "",
    ignorecase: bool = False,  # noqa: FBT001, FBT002 - the filter's users may give it by position
    multiline: bool = False,  # noqa: FBT001, FBT002
    count: int = 0,
) -> str:
    """Ansible's filter of that name, which src.plugin's Rigelfiles use."""
    flags = (re.IGNORECASE if ignorecase else 0) | (re.MULTILINE if multiline else 0)
    return re.sub(pattern, replacement, str(value), count=count, flags=flags)

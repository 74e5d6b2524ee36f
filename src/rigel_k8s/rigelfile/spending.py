"""How much a Rigelfile has expanded to so far; above a limit, reading ends with an error.

jinja2 shields Python from an expression, but `"a" * 10**9` fills the memory, and a regular
expression may take for ever. The kernel stops both: a timer counts the processor's time, which all
expressions of a file share, and a limit of the address space refuses what is too large. Signals
reach the main thread only, where files of unknown origin are checked and rendered. In other
threads, where Rigel 0.3 runs a file, the time is looked at before each expression.
"""

from __future__ import annotations

import resource
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import thread_time
from typing import NoReturn

import attrs

from rigel_k8s.errors import ProblemsError
from rigel_k8s.rigelfile.findings import Finding, make_finding, render
from rigel_k8s.rigelfile.limits import (
    DEEPEST,
    EXPRESSION_SECONDS,
    LONGEST_LINE,
    LONGEST_TEXT,
    MOST_LOOKED_AT,
    MOST_MEMORY,
    MOST_TEXT,
    MOST_VALUES,
)
from rigel_k8s.rigelfile.source import Source, YamlNode

KIND = "too-large"
#: Linux' numbers about this process; the first one is its address space in pages.
STATM = Path("/proc/self/statm")
#: Seconds until a signal that something swallowed is sent again.
AGAIN = 0.2


class TooLarge(ProblemsError):
    """A file that expands to more than a limit allows; it is not checked further."""

    def __init__(self, source: Source, finding: Finding) -> None:
        super().__init__(
            f"{source.name} has 1 problem",
            lambda width: [render(source, finding, width=width)],
            width=LONGEST_LINE,
        )
        self.finding = finding


@attrs.define
class Spending:
    """How much one file has expanded to."""

    source: Source
    values: int = 0
    text: int = 0
    looked_at: int = 0
    seconds: float = 0

    def add_values(self, use: YamlNode, made: YamlNode) -> None:
        """Count the values that a template at `use` gives."""
        self.values += count(made, MOST_VALUES)
        if self.values > MOST_VALUES:
            self.refuse(use, f"templates make more than {MOST_VALUES} values in this file")

    def add_text(self, use: YamlNode, length: int) -> None:
        """Count the characters that templates at `use` give."""
        self.text += length
        if length > LONGEST_TEXT:
            self.refuse(use, f"templates make a text of more than {LONGEST_TEXT} characters")
        if self.text > MOST_TEXT:
            self.refuse(use, f"templates make more than {MOST_TEXT} characters in this file")

    def add_look(self, options: YamlNode) -> None:
        """Count the options of a job or provider, which are about to be checked."""
        self.looked_at += count(options, MOST_LOOKED_AT)
        if self.looked_at > MOST_LOOKED_AT:
            message = (
                f"jobs, their uses and the combinations of matrices make more than"
                f" {MOST_LOOKED_AT} values to check: split this file"
            )
            self.refuse(options, message)

    @contextmanager
    def limit_expression(self, node: YamlNode) -> Iterator[None]:
        """Limit the time and the memory of an expression at a node.

        Raises:
            TooLarge: the expressions of this file have taken all the time that they may.
            MemoryError: it needs too much memory.
        """

        def stop(*_: object) -> NoReturn:
            message = "the expressions of this file take too long; the check stopped at this one"
            self.refuse(node, message)

        left = EXPRESSION_SECONDS - self.seconds
        if left <= 0:
            stop()
        began = thread_time()
        try:
            if threading.current_thread() is threading.main_thread():
                with _limit_time(left, stop), _limit_memory():
                    yield
            else:
                yield
        finally:
            self.seconds += thread_time() - began

    def refuse(self, node: YamlNode, message: str) -> NoReturn:
        """End the check of this file, with one error at a node."""
        raise TooLarge(self.source, make_finding(node, message, KIND))


@contextmanager
def _limit_time(seconds: float, stop: Callable[..., NoReturn]) -> Iterator[None]:
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


def count(node: YamlNode, most: int) -> int:
    """Return how many values a node has; counting stops after `most`."""
    waiting, found = [node], 0
    while waiting and found <= most:
        found += 1
        waiting.extend(waiting.pop().children())
    return found


@contextmanager
def bounded(source: Source, node: YamlNode) -> Iterator[None]:
    """Report values that are nested too deep for Python's stack.

    Raises:
        TooLarge: at the node.
    """
    try:
        yield
    except RecursionError:
        message = "values and templates are nested too deep"
        raise TooLarge(source, make_finding(node, message, KIND)) from None


def refuse_depth(source: Source, root: YamlNode) -> None:
    """Refuse values that templates have nested deeper than YAML may.

    Raises:
        TooLarge: at the first of them.
    """
    level = [root]
    for _ in range(DEEPEST + 1):
        level = [child for node in level for child in node.children()]
    if level:
        message = f"templates nest values more than {DEEPEST} deep"
        raise TooLarge(source, make_finding(level[0], message, KIND))

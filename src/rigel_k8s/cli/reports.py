"""How a running command reports its progress: lines, or live rows in a terminal.

Both are the Reporter of jobs/job.py; jobs call them from several threads.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click

from rigel_k8s import signals
from rigel_k8s.cli.width import WARNING, is_dumb, shorten


class Lines:
    """One line for each report; a progress row's line only if its state changes."""

    def __init__(self, *, quiet: bool = False, prefix: str = "", shared: Any = None) -> None:
        self._quiet = quiet
        self._prefix = prefix
        self._lock: threading.Lock = shared or threading.Lock()
        self._states: dict[str, str] = {}

    def line(self, text: str) -> None:
        if not self._quiet:
            self._print(text)

    def warn(self, text: str) -> None:
        """Print a warning, even if quiet."""
        self._print(click.style("warning: ", fg=WARNING, bold=True) + text)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Print the state of one thing if it changed."""
        if state and self._states.get(key) != state:
            self._states[key] = state
            mark = "✓ " if done else "  "
            self.line(f"{mark}{key}: {state}")

    def child(self, name: str) -> Lines:
        """Return a reporter whose lines start with a name."""
        return Lines(quiet=self._quiet, prefix=f"{self._prefix}[{name}] ", shared=self._lock)

    def _print(self, text: str) -> None:
        with self._lock:
            signals.begin_line()
            for part in text.splitlines() or [""]:
                click.echo(self._prefix + part, err=True)


class Rows:
    """Lines that stay, and below them a row for each thing in progress."""

    def __init__(self, live: Any, prefix: str = "", table: _Table | None = None) -> None:
        self._live = live
        self._prefix = prefix
        self._table = table or _Table()

    def line(self, text: str) -> None:
        """Print a line above the rows."""
        self._live.console.print(self._prefix + text, markup=False, highlight=False, soft_wrap=True)

    def warn(self, text: str) -> None:
        """Print a warning above the rows."""
        from rich.text import Text

        warning = Text("warning: ", style=f"bold {WARNING}") + Text(self._prefix + text)
        self._live.console.print(warning, soft_wrap=True)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Change a row; one that is done becomes a line that stays, if it has a state."""
        name = self._prefix + key
        if done:
            if self._table.remove(name) and state:
                self.line(f"✓ {key}: {state}")
        else:
            self._table.set(name, state)
        self._live.update(self._table)

    def child(self, name: str) -> Rows:
        """Return a reporter whose lines and rows start with a name."""
        return Rows(self._live, f"{self._prefix}[{name}] ", self._table)


class _Table:
    """The rows in progress, with their duration."""

    def __init__(self) -> None:
        self._rows: dict[str, tuple[str, float]] = {}
        self._lock = threading.Lock()
        self._done: set[str] = set()

    def set(self, key: str, state: str) -> None:
        with self._lock:
            started = self._rows.get(key, ("", time.monotonic()))[1]
            self._rows[key] = (state, started)
            self._done.discard(key)

    def remove(self, key: str) -> bool:
        """Remove a row; False if it was removed before."""
        with self._lock:
            self._rows.pop(key, None)
            new = key not in self._done
            self._done.add(key)
            return new

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        """Yield a line for each row that fits: name, state as far as there is room, age.

        The ^C that the terminal writes behind the last line must not begin a line of its own.
        """
        from rich.text import Text

        with self._lock:
            now = time.monotonic()
            rows = [(k, " ".join(s.split()), f"{now - t:.0f}s") for k, (s, t) in self._rows.items()]
        fit = max(1, console.size.height - 2)
        hidden = len(rows) - fit
        if hidden > 0:
            rows, more = rows[:fit], f"  ... and {hidden} more"
        width = options.max_width - len("^C")
        names = min(width // 2, max((len(key) for key, _, _ in rows), default=0) + 2)
        ages = max((len(age) for _, _, age in rows), default=0)
        room = max(1, width - names - ages - 2)
        for key, state, age in rows:
            line = Text().append(shorten(f"  {key}", names).ljust(names), style="cyan")
            line.append(f" {cut(state, room).ljust(room)}")
            yield line.append(f" {age:>{ages}}", style="dim")
        if hidden > 0:
            yield Text(more[:width], style="dim")


def cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: width - 1]}…"


@contextmanager
def reporter(*, quiet: bool = False, plain: bool = False) -> Iterator[Lines | Rows]:
    """Yield the reporter for the output: rows in a terminal, else lines.

    Both write to standard error: standard output is for results.
    """
    if quiet or plain or is_dumb() or not sys.stderr.isatty():
        yield Lines(quiet=quiet)
        return
    from rich.console import Console
    from rich.live import Live

    try:
        with Live(
            console=Console(stderr=True, force_terminal=True), refresh_per_second=8, transient=True
        ) as live:
            yield Rows(live)
    finally:
        signals.forget_echo()  # it was erased with the rows

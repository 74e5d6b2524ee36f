"""Rollbacks that a page requests: one at a time, reported to all pages."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.release.types import Revision
from rigel_k8s.report import Reporter
from rigel_k8s.ui.feed import Feed

SHOWN = 30  # lines of a rollback that pages show

Rollback = Callable[[int, Reporter, threading.Event], Revision]


class Changes:
    """Carries out rollbacks, and publishes how they go."""

    def __init__(self, feed: Feed, rollback: Rollback) -> None:
        self._feed, self._rollback = feed, rollback
        self._cancel = threading.Event()
        self._lock = threading.Lock()
        self._thread: threading.Thread | None = None

    def start(self, number: int) -> bool:
        """Begin to roll back to a revision; return False if another rollback is running."""
        with self._lock:
            if self._thread is not None and self._thread.is_alive():
                return False
            report = PageReport(self._feed, number)
            self._thread = threading.Thread(
                target=self._run, args=(number, report), name="rigel-ui-rollback"
            )
            self._thread.start()
            return True

    def _run(self, number: int, report: PageReport) -> None:
        try:
            made = self._rollback(number, report, self._cancel)
        except RigelK8sError as error:
            for detail in error.details:
                report.line(detail)
            report.end("failed", error.message + (f" ({error.hint})" if error.hint else ""))
        except Exception as error:
            report.end("failed", f"{type(error).__name__}: {error}")
            raise
        else:
            report.end("done", f"revision {made.number}: {made.description}")

    @property
    def running(self) -> bool:
        """Whether a rollback is running."""
        return self._thread is not None and self._thread.is_alive()

    def close(self) -> None:
        """Interrupt a rollback, and wait until it has ended."""
        self._cancel.set()
        if self._thread is not None:
            self._thread.join()


class PageReport:
    """A reporter whose lines are an entry."""

    def __init__(self, feed: Feed, number: int) -> None:
        self._feed = feed
        self._lock = threading.Lock()
        self._lines: list[str] = []
        self._rows: dict[str, str] = {}
        self._entry: dict[str, Any] = {"to": number, "state": "running", "message": ""}
        self._publish()

    def line(self, text: str) -> None:
        """Add a line."""
        with self._lock:
            self._lines = [*self._lines, text][-SHOWN:]
            self._publish()

    def warn(self, text: str) -> None:
        """Add a warning."""
        self.line(f"warning: {text}")

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Show the present state of one thing."""
        with self._lock:
            self._rows[key] = f"{'✓' if done else '…'} {key}: {state}"
            if not state:
                del self._rows[key]
            self._publish()

    def end(self, state: str, message: str) -> None:
        """Show how it ended."""
        with self._lock:
            self._entry |= {"state": state, "message": message}
            self._publish()

    def _publish(self) -> None:
        lines = [*self._rows.values(), *self._lines][-SHOWN:]
        self._feed.publish("change", {"change": {**self._entry, "lines": lines}})

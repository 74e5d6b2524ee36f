"""What all pages show, and what has changed since: one text for all of them.

Any thread publishes; each open page has a thread of the server that sends it texts. A page that
cannot keep up gets everything again instead of what it has missed.
"""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Callable, Mapping
from typing import Any

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.release.types import Revision
from rigel_k8s.report import Reporter

BEHIND = 64  # texts that a page may be behind

Entries = dict[str, Any]


class Feed:
    """Entries by key, and the pages that show them."""

    def __init__(self) -> None:
        self._entries: Entries = {}
        self._lock = threading.RLock()
        self._pages: set[Page] = set()

    def publish(self, group: str, entries: Mapping[str, Any]) -> None:
        """Replace the entries of a group: those whose key begins with it and a slash, or is it."""
        with self._lock:
            old = {key for key in self._entries if key.partition("/")[0] == group}
            changed = {k: v for k, v in entries.items() if self._entries.get(k) != v}
            gone = sorted(old - entries.keys())
            if not (changed or gone):
                return
            for key in gone:
                del self._entries[key]
            self._entries.update(changed)
            text = json.dumps({"set": changed, "gone": gone})
            for page in self._pages:
                page.send(text)

    def get(self, key: str) -> Any:
        """Return an entry, None if it is missing."""
        with self._lock:
            return self._entries.get(key)

    def list_group(self, group: str) -> Entries:
        with self._lock:
            return {k: v for k, v in self._entries.items() if k.partition("/")[0] == group}

    @property
    def watched(self) -> bool:
        """Whether a page is open."""
        return bool(self._pages)

    def subscribe(self) -> Page:
        """Return a page that gets everything, and from now on what changes."""
        page = Page(self.write_all)
        with self._lock:
            page.send(self.write_all())
            self._pages.add(page)
        return page

    def unsubscribe(self, page: Page) -> None:
        """Send a page nothing more."""
        with self._lock:
            self._pages.discard(page)

    def write_all(self) -> str:
        """Return everything, for a page that is behind."""
        with self._lock:
            return json.dumps({"all": self._entries})


class Page:
    """One open page: the texts that are to be sent to it."""

    def __init__(self, everything: Callable[[], str]) -> None:
        self._everything = everything
        self._queue: queue.Queue[str] = queue.Queue(BEHIND)
        self._behind = False

    def send(self, text: str) -> None:
        """Send a text, without waiting for the page."""
        try:
            self._queue.put_nowait(text)
        except queue.Full:
            self._behind = True

    def next(self, timeout: float) -> str | None:
        """Return the next text; None if no text comes within some seconds."""
        if self._behind and self._queue.empty():
            self._behind = False
            return self._everything()
        try:
            return self._queue.get(timeout=timeout)
        except queue.Empty:
            return None


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
        with self._lock:
            self._lines = [*self._lines, text][-SHOWN:]
            self._publish()

    def warn(self, text: str) -> None:
        self.line(f"warning: {text}")

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """Show the present state of one thing."""
        with self._lock:
            self._rows[key] = f"{'✓' if done else '…'} {key}: {state}"
            if not state:
                del self._rows[key]
            self._publish()

    def end(self, state: str, message: str) -> None:
        with self._lock:
            self._entry |= {"state": state, "message": message}
            self._publish()

    def _publish(self) -> None:
        lines = [*self._rows.values(), *self._lines][-SHOWN:]
        self._feed.publish("change", {"change": {**self._entry, "lines": lines}})

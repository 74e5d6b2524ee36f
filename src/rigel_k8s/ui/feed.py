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
        """Return the entries of a group."""
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

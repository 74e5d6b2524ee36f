"""What all pages show, and what has changed since: one text for all of them.

Threads publish; pages subscribe in the server's event loop. A page that cannot keep up gets
everything again instead of what it has missed.
"""

from __future__ import annotations

import asyncio
import json
import threading
from collections.abc import Callable, Mapping
from typing import Any

BEHIND = 64  # messages that a page may be behind

Entries = dict[str, Any]


class Feed:
    """Entries by key, and the pages that show them."""

    def __init__(self) -> None:
        self._entries: Entries = {}
        self._lock = threading.Lock()
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

    def subscribe(self, page: Page) -> None:
        """Send a page everything, and from now on what changes."""
        with self._lock:
            page.send(self._write_all())
            self._pages.add(page)

    def unsubscribe(self, page: Page) -> None:
        """Send a page nothing more."""
        with self._lock:
            self._pages.discard(page)

    def write_all(self) -> str:
        """Return everything, for a page that is behind."""
        with self._lock:
            return self._write_all()

    def _write_all(self) -> str:
        return json.dumps({"all": self._entries})


class Page:
    """One open page: what is to be sent to it, in the server's event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop, everything: Callable[[], str]) -> None:
        self._loop = loop
        self._everything = everything
        self._queue: asyncio.Queue[str | None] = asyncio.Queue()
        self._behind = False

    def send(self, text: str) -> None:
        """Send a text, from any thread."""
        self._call(text)

    def close(self) -> None:
        """End the page's connection, from any thread."""
        self._call(None)

    def _call(self, text: str | None) -> None:
        try:
            self._loop.call_soon_threadsafe(self._put, text)
        except RuntimeError:  # the loop is closed: the server has ended
            return

    def _put(self, text: str | None) -> None:
        if text is not None and self._queue.qsize() >= BEHIND:
            self._behind = True
            return
        self._queue.put_nowait(text)

    async def next(self) -> str | None:
        """Return the next text to send; None at the end."""
        if self._behind and self._queue.empty():
            self._behind = False
            return self._everything()
        return await self._queue.get()

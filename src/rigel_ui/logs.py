"""The logs of nodes, each followed once for all pages that show it, and only while one does."""

from __future__ import annotations

import itertools
import json
import threading
from collections import deque
from collections.abc import Callable, Iterator

from rigel_k8s.commands.logs.lines import LogLine, LogOptions, stamp
from rigel_k8s.commands.logs.reading import read_lines
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import RigelK8sError
from rigel_ui.feed import Page

KEPT = 500  # lines of a node that a page gets at its beginning
BATCH = 0.15  # seconds in which lines are collected before pages get them
MOST = 300  # lines that pages get at once; further ones are counted and left out
PAUSE = 2.0  # seconds before the next attempt, if a log cannot be followed

Line = tuple[str, str, str, str, bool]  # time, level, pod, text, whether it is a note of ours
Read = Callable[[str, threading.Event], Iterator[LogLine]]


class LogHub:
    """The logs that pages follow."""

    def __init__(self, read: Read) -> None:
        self._read = read
        self._lock = threading.Lock()
        self._logs: dict[str, NodeLog] = {}

    def follow(self, node: str, page: Page) -> None:
        """Send a page a node's log, from now on."""
        with self._lock:
            if node not in self._logs:
                self._logs[node] = NodeLog(node, self._read)
            self._logs[node].add(page)

    def leave(self, page: Page) -> None:
        """Send a page no log."""
        with self._lock:
            for node, log in list(self._logs.items()):
                if log.remove(page):
                    del self._logs[node]

    def close(self) -> None:
        """End all follows."""
        with self._lock:
            for log in self._logs.values():
                log.over.set()
            self._logs.clear()

    def count(self) -> int:
        """Return how many logs are followed."""
        with self._lock:
            return len(self._logs)


class NodeLog:
    """One node's log: the last lines, and the pages that show it."""

    def __init__(self, node: str, read: Read) -> None:
        self.node = node
        self.over = threading.Event()
        self._read = read
        self._lock = threading.Lock()
        self._pages: set[Page] = set()
        self._kept: deque[Line] = deque(maxlen=KEPT)
        self._fresh: list[Line] = []
        self._left = 0
        for name, target in (("read", self._follow), ("send", self._send)):
            threading.Thread(target=target, name=f"rigel-ui-log-{name}", daemon=True).start()

    def add(self, page: Page) -> None:
        """Send a page the lines that there are, and those that come."""
        with self._lock:
            self._flush()
            page.send(self._write(list(self._kept), begins=True))
            self._pages.add(page)

    def remove(self, page: Page) -> bool:
        """Send a page nothing more; return whether no page is left, which ends the follow."""
        with self._lock:
            if page not in self._pages:
                return False
            self._pages.remove(page)
            if not self._pages:
                self.over.set()
            return not self._pages

    def _follow(self) -> None:
        """Read lines; a node without a pod is looked at again."""
        reported = ""
        while not self.over.is_set():
            self._begin()
            try:
                for line in self._read(self.node, self.over):
                    reported = ""
                    self._take(line)
                    if self.over.is_set():
                        return
            except RigelK8sError as error:
                if error.message != reported:
                    self._take(LogLine(self.node, "", error.message, note=True))
                reported = error.message
            self.over.wait(PAUSE)

    def _begin(self) -> None:
        """Forget what was read before: the last lines come again."""
        with self._lock:
            if any(not note for *_, note in self._kept):
                self._kept.clear()
                self._fresh.clear()
                text = self._write([], begins=True)
                for page in self._pages:
                    page.send(text)

    def _take(self, line: LogLine) -> None:
        time = "" if line.time is None else stamp(line.time)
        with self._lock:
            if len(self._fresh) >= MOST:
                self._left += 1
                return
            self._fresh.append((time, line.level, line.pod, line.text, line.note))

    def _send(self) -> None:
        while not self.over.wait(BATCH):
            with self._lock:
                self._flush()

    def _flush(self) -> None:
        """Send what has come to the pages that are there."""
        if self._left:
            words = f"{self._left} more lines are left out: `rigel logs` prints them all"
            self._fresh.append(("", "", "", words, True))
        lines, self._fresh, self._left = self._fresh, [], 0
        if not lines:
            return
        self._kept.extend(lines)
        text = self._write(lines, begins=False)
        for page in self._pages:
            page.send(text)

    def _write(self, lines: list[Line], *, begins: bool) -> str:
        return json.dumps({"log": {"node": self.node, "begins": begins, "lines": lines}})


def read_log(found: Release) -> Read:
    """Return what follows a release's logs."""

    def read(node: str, cancel: threading.Event) -> Iterator[LogLine]:
        options = LogOptions(follow=True, tail=KEPT - 1)
        return itertools.takewhile(
            lambda _: not cancel.is_set(), read_lines(found, [node], options, cancel)
        )

    return read

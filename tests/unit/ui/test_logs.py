"""A node's log is followed once for all pages, and only while one shows it."""

from __future__ import annotations

import json
import queue
import threading
from collections.abc import Iterator
from typing import Any

import attrs
import pytest

from rigel_k8s.commands.logs.lines import LogLine
from rigel_k8s.errors import UserError
from rigel_ui.feed import Page
from rigel_ui.logs import KEPT, MOST, LogHub
from tests.support.until import until


@attrs.define
class Source:
    """Logs of nodes: what a test puts into the queue is a line."""

    lines: queue.Queue[LogLine | Exception] = attrs.field(factory=queue.Queue)
    reads: list[str] = attrs.field(factory=list)
    open: int = 0

    def read(self, node: str, cancel: threading.Event) -> Iterator[LogLine]:
        self.reads.append(node)
        self.open += 1
        try:
            while not cancel.is_set():
                try:
                    line = self.lines.get(timeout=0.01)
                except queue.Empty:
                    continue
                if isinstance(line, Exception):
                    raise line
                yield line
        finally:
            self.open -= 1

    def say(self, *texts: str) -> None:
        for text in texts:
            self.lines.put(LogLine("talker", "talker-1", text, time=10**18, level="info"))


class Reader(Page):
    """A page that keeps what it gets."""

    def __init__(self) -> None:
        super().__init__(str)
        self.got: list[Any] = []

    def send(self, text: str) -> None:
        self.got.append(json.loads(text)["log"])

    @property
    def texts(self) -> list[str]:
        """The lines since the last beginning."""
        shown: list[str] = []
        for part in self.got:
            shown = [*([] if part["begins"] else shown), *(line[3] for line in part["lines"])]
        return shown


@pytest.fixture
def source() -> Source:
    return Source()


@pytest.fixture
def hub(source: Source) -> Iterator[LogHub]:
    made = LogHub(source.read)
    yield made
    made.close()
    until(lambda: source.open == 0, "the end of all follows", 20)


def test_pages_share_a_follow(source: Source, hub: LogHub) -> None:
    """The second page gets what was said before, and nothing is read again for it."""
    first, second = Reader(), Reader()
    hub.follow("talker", first)
    source.say("one", "two")
    until(lambda: first.texts == ["one", "two"], "the lines", 20)
    hub.follow("talker", second)
    assert second.texts == ["one", "two"]
    source.say("three")
    until(lambda: second.texts == first.texts == ["one", "two", "three"], "the line", 20)
    assert source.reads == ["talker"]
    assert first.got[0]["node"] == "talker"
    assert first.got[-1]["lines"] == [
        ["2001-09-09T01:46:40.000000000Z", "info", "talker-1", "three", False]
    ]


def test_the_last_page_ends_the_follow(source: Source, hub: LogHub) -> None:
    """A page that shows another log, or is closed, leaves."""
    first, second = Reader(), Reader()
    hub.follow("talker", first)
    hub.follow("talker", second)
    until(lambda: source.open == 1, "the follow", 20)
    hub.leave(first)
    assert hub.count() == 1
    hub.leave(second)
    assert hub.count() == 0
    until(lambda: source.open == 0, "the end of the follow", 20)


def test_a_flood_is_cut_and_counted(source: Source, hub: LogHub) -> None:
    """A node that says more than a browser can show does not stop the page."""
    page = Reader()
    hub.follow("talker", page)
    source.say(*map(str, range(20 * MOST)))
    until(lambda: source.lines.empty() and page.texts, "the flood to be over", 60)
    until(lambda: any("more lines are left out" in text for text in page.texts), "the count", 20)
    late = Reader()
    hub.follow("talker", late)
    assert len(late.texts) <= KEPT


def test_a_log_that_cannot_be_read_is_tried_again(
    source: Source, hub: LogHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reason is told once; what was shown before comes again, not twice."""
    monkeypatch.setattr("rigel_ui.logs.PAUSE", 0.01)
    page = Reader()
    hub.follow("talker", page)
    source.lines.put(UserError("no pod of talker"))
    source.lines.put(UserError("no pod of talker"))
    source.say("one")
    until(lambda: page.texts == ["no pod of talker", "one"], "the line", 20)
    source.lines.put(UserError("the cluster is away"))
    source.say("one", "two")
    until(lambda: page.texts == ["one", "two"], "the lines again", 20)

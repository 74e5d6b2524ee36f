"""What pages get: changes only, and everything where they could not keep up."""

from __future__ import annotations

import json
from typing import Any

from rigel_ui.feed import BEHIND, Feed, Page


def drain(page: Page) -> list[Any]:
    """Return what is to be sent to a page now."""
    found = []
    while (text := page.next(0.0)) is not None:
        found.append(json.loads(text))
    return found


def test_a_page_gets_what_has_changed() -> None:
    """Neither what is as before, nor another group."""
    feed = Feed()
    feed.publish("node", {"node/a": 1, "node/b": 2})
    feed.publish("box", {"box/a": 1})
    page = feed.subscribe()
    feed.publish("node", {"node/a": 1, "node/b": 3})
    feed.publish("node", {"node/a": 1, "node/b": 3})
    feed.publish("node", {"node/b": 3})
    feed.unsubscribe(page)
    feed.publish("node", {})
    assert drain(page) == [
        {"all": {"node/a": 1, "node/b": 2, "box/a": 1}},
        {"set": {"node/b": 3}, "gone": []},
        {"set": {}, "gone": ["node/a"]},
    ]


def test_a_slow_page_gets_everything_again() -> None:
    """It does not grow without end, and ends up with what is true."""
    feed = Feed()
    page = feed.subscribe()
    for number in range(10 * BEHIND):
        feed.publish("release", {"release": number})
    got = drain(page)
    assert len(got) == BEHIND + 1
    assert got[-1] == {"all": {"release": 10 * BEHIND - 1}}


def test_pages_share_one_text(monkeypatch: Any) -> None:
    """A change is written once, however many pages are open."""
    feed, written = Feed(), []
    real = json.dumps
    monkeypatch.setattr("rigel_ui.feed.json.dumps", lambda data: written.append(data) or real(data))
    pages = [feed.subscribe() for _ in range(10)]
    written.clear()
    feed.publish("release", {"release": 1})
    assert [len(drain(page)) for page in pages] == [2] * 10
    assert written == [{"set": {"release": 1}, "gone": []}]

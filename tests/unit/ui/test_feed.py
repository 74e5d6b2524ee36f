"""What pages get: changes only, and everything where they could not keep up."""

from __future__ import annotations

import asyncio
import json
from typing import Any

from rigel_k8s.ui.feed import BEHIND, Feed, Page


async def drain(page: Page) -> list[Any]:
    """Return what is to be sent to a page now."""
    found = []
    while True:
        try:
            text = await asyncio.wait_for(page.next(), 0.05)
        except asyncio.TimeoutError:
            return found
        found.append(None if text is None else json.loads(text))


def run(scene: Any) -> Any:
    """Run a scene in an event loop of its own."""
    return asyncio.run(scene())


def test_a_page_gets_what_has_changed() -> None:
    """Neither what is as before, nor another group."""
    feed = Feed()
    feed.publish("node", {"node/a": 1, "node/b": 2})
    feed.publish("box", {"box/a": 1})

    async def scene() -> list[Any]:
        page = Page(asyncio.get_running_loop(), feed.write_all)
        feed.subscribe(page)
        feed.publish("node", {"node/a": 1, "node/b": 3})
        feed.publish("node", {"node/a": 1, "node/b": 3})
        feed.publish("node", {"node/b": 3})
        feed.unsubscribe(page)
        feed.publish("node", {})
        return await drain(page)

    assert run(scene) == [
        {"all": {"node/a": 1, "node/b": 2, "box/a": 1}},
        {"set": {"node/b": 3}, "gone": []},
        {"set": {}, "gone": ["node/a"]},
    ]


def test_a_slow_page_gets_everything_again() -> None:
    """It does not grow without end, and ends up with what is true."""
    feed = Feed()

    async def scene() -> list[Any]:
        page = Page(asyncio.get_running_loop(), feed.write_all)
        feed.subscribe(page)
        for number in range(10 * BEHIND):
            feed.publish("release", {"release": number})
        await asyncio.sleep(0)
        return await drain(page)

    got = run(scene)
    assert len(got) <= BEHIND + 1
    assert got[-1] == {"all": {"release": 10 * BEHIND - 1}}


def test_pages_share_one_text(monkeypatch: Any) -> None:
    """A change is written once, however many pages are open."""
    feed, written = Feed(), []
    real = json.dumps
    monkeypatch.setattr(
        "rigel_k8s.ui.feed.json.dumps", lambda data: written.append(data) or real(data)
    )

    async def scene() -> None:
        pages = [Page(asyncio.get_running_loop(), feed.write_all) for _ in range(10)]
        for page in pages:
            feed.subscribe(page)
        written.clear()
        feed.publish("release", {"release": 1})
        for page in pages:
            assert len(await drain(page)) == 2

    run(scene)
    assert written == [{"set": {"release": 1}, "gone": []}]


def test_a_closed_loop_is_no_error() -> None:
    """A thread may publish while the server ends."""
    feed = Feed()

    async def scene() -> None:
        feed.subscribe(Page(asyncio.get_running_loop(), feed.write_all))

    run(scene)
    feed.publish("release", {"release": 1})
    assert feed.get("release") == 1

"""The twin's `current`: it says what was set last, also after Ditto was away."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import attrs
import pytest

from rigel_muto.agent import current
from rigel_muto.agent.current import Announcer, describe_current
from rigel_muto.agent.wanted import Record
from rigel_muto.ditto import Access, Ditto
from tests.support.http_server import Exchange, HttpServer, serving
from tests.support.recorder import Recorder
from tests.support.until import until

THING = "org:robot"
PLACE = f"/api/2/things/{THING}"


@attrs.define
class Things:
    """What a Ditto knows; `away` lets it refuse everything."""

    known: dict[str, Any] = attrs.field(factory=dict)
    away: bool = False
    asked: list[str] = attrs.field(factory=list)
    lock: threading.Lock = attrs.field(factory=threading.Lock)

    def answer(self, exchange: Exchange) -> None:
        request = exchange.request_
        with self.lock:
            self.asked.append(request.method)
            if self.away:
                exchange.say(503)
            elif request.path == PLACE and request.method == "PUT":
                self.known["thing"] = request.json
                exchange.say(201)
            elif "thing" not in self.known:
                exchange.say(404)
            elif request.path == PLACE:
                exchange.say(204)
            else:
                self.known["current"] = request.json
                exchange.say(204)


@pytest.fixture
def things() -> Things:
    return Things()


@pytest.fixture
def ditto(things: Things) -> Iterator[HttpServer]:
    with serving(things.answer) as server:
        yield server


@pytest.fixture
def announcer(
    ditto: HttpServer, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Announcer]:
    monkeypatch.setattr(current, "AGAIN", 0.05)
    made = Announcer(Ditto(ditto.url, Access(), {}), THING, report)
    made.start()
    yield made
    made.close()


def test_the_thing_is_made_where_it_is_missing(announcer: Announcer, things: Things) -> None:
    announcer.set({"stackId": "org:a", "state": "active"})
    until(lambda: "current" in things.known, "the state")
    assert things.asked == ["PATCH", "PUT", "PUT"]
    assert set(things.known["thing"]["features"]) == {"context", "stack", "telemetry"}
    assert things.known["current"] == {"stackId": "org:a", "state": "active"}


def test_the_newest_state_is_written_when_ditto_is_back(
    announcer: Announcer, things: Things, report: Recorder
) -> None:
    """Who wonders why the twin is old finds one line about it."""
    things.away = True
    announcer.set({"state": "starting"})
    until(lambda: len(things.asked) > 3, "attempts")
    announcer.set({"state": "active"})
    things.away = False
    until(lambda: things.known.get("current") == {"state": "active"}, "the state")
    until(lambda: report.lines == ["the twin is up to date again"], "the line")
    assert len(report.warnings) == 1
    assert "answered 503" in report.warnings[0]


def test_what_is_left_is_written_at_the_end(announcer: Announcer, things: Things) -> None:
    announcer.set({"state": "killed"})
    announcer.close()
    assert things.known["current"] == {"state": "killed"}


def test_a_failure_has_its_cause() -> None:
    record = Record(label="org:a", state="failed", cause="talker: no such image")
    said = {"stackId": "org:a", "state": "failed", "cause": "talker: no such image"}
    assert describe_current(record) == said
    assert describe_current(Record(label="org:a", state="active")) == {
        "stackId": "org:a",
        "state": "active",
    }

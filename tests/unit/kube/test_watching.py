"""Watches that outlive lost connections and forgotten versions."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import watching
from tests.support.http_server import Exchange

Answer = Callable[[Exchange], None]


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A lost watch is opened again at once."""
    monkeypatch.setattr(watching, "PAUSE", 0.01)


def pod(name: str, version: int, uid: str = "") -> dict[str, Any]:
    return {"metadata": {"name": name, "uid": uid or f"u-{name}", "resourceVersion": str(version)}}


def listed(version: int, *items: Any) -> Answer:
    body = {"metadata": {"resourceVersion": str(version)}, "items": items}
    return lambda exchange: exchange.say(200, body)


def event(kind: str, what: Any) -> dict[str, Any]:
    return {"type": kind, "object": what}


def stream(*events: Any) -> Answer:
    return lambda exchange: exchange.stream(*events, b"")


def lost(*events: Any) -> Answer:
    """The connection breaks in the middle of a line."""

    def answer(exchange: Exchange) -> None:
        exchange.stream(*events, b'{"type": "ADD')
        exchange.hang_up()

    return answer


def silent(exchange: Exchange) -> None:
    exchange.stream()
    time.sleep(20)


def follow(serve: Any, *answers: Answer, events: int, **options: Any) -> tuple[list[Any], Any]:
    """Return the first events of a watch that gets these answers, and what was asked."""
    script = iter(answers)
    client, server = serve(lambda exchange: next(script, silent)(exchange))
    seen = []
    watched = client.watch("v1", "Pod", "n", labels="a=b", **{"seconds": 20, **options})
    for one in watched:
        assert (one.object["apiVersion"], one.object["kind"]) == ("v1", "Pod")
        seen.append((one.type, one.object["metadata"]["name"]))
        if len(seen) == events:
            break
    watched.close()
    return seen, server


def versions(server: Any) -> list[str | None]:
    """Return the version of each watch, None for a list."""
    return [request.query.get("resourceVersion", [None])[0] for request in server.requests]


def test_what_is_there_comes_first_and_then_what_changes(serve: Any) -> None:
    """The watch begins at the version of the list; both have the selectors."""
    seen, server = follow(
        serve, listed(7, pod("a", 3)), stream(event("MODIFIED", pod("a", 8))), events=2
    )
    assert seen == [("ADDED", "a"), ("MODIFIED", "a")]
    assert versions(server) == [None, "7"]
    assert {request.query["labelSelector"][0] for request in server.requests} == {"a=b"}
    assert server.requests[1].query["watch"] == ["true"]
    assert server.requests[1].query["timeoutSeconds"] == ["20"]
    assert server.list_requests() == ["GET /api/v1/namespaces/n/pods"] * 2


@pytest.mark.parametrize("end", [stream, lost])
def test_a_watch_that_ends_is_opened_again_where_it_was(serve: Any, end: Any) -> None:
    """Nothing comes twice, nothing is missed; a bookmark moves the place and is not told."""
    seen, server = follow(
        serve,
        listed(7),
        end(event("ADDED", pod("a", 8))),
        end(event("BOOKMARK", {"metadata": {"resourceVersion": "20"}})),
        stream(event("DELETED", pod("a", 21))),
        events=2,
    )
    assert seen == [("ADDED", "a"), ("DELETED", "a")]
    assert versions(server) == [None, "7", "8", "20"]


def refused(exchange: Exchange) -> None:
    exchange.say(410, {"message": "too old resource version"})


@pytest.mark.parametrize(
    "forgotten", [refused, stream(event("ERROR", {"code": 410, "message": "too old"}))]
)
def test_a_forgotten_version_loses_nothing(serve: Any, forgotten: Answer) -> None:
    """What has gone meanwhile comes as DELETED, what is there as MODIFIED, what is new as ADDED."""
    seen, server = follow(
        serve,
        listed(7, pod("a", 3), pod("b", 4), pod("c", 5, "old")),
        forgotten,
        listed(90, pod("b", 80), pod("c", 81, "new"), pod("d", 82)),
        stream(event("MODIFIED", pod("d", 91))),
        events=9,
    )
    assert seen[:3] == [("ADDED", "a"), ("ADDED", "b"), ("ADDED", "c")]
    assert sorted(seen[3:8]) == [
        ("ADDED", "c"),
        ("ADDED", "d"),
        ("DELETED", "a"),
        ("DELETED", "c"),
        ("MODIFIED", "b"),
    ]
    assert versions(server) == [None, "7", None, "90"]


def test_a_deleted_object_is_not_deleted_again(serve: Any) -> None:
    """After a new list, what has been told already is over."""
    seen, _ = follow(
        serve,
        listed(7, pod("a", 3)),
        stream(event("DELETED", pod("a", 8))),
        refused,
        listed(90, pod("b", 80)),
        events=3,
    )
    assert seen == [("ADDED", "a"), ("DELETED", "a"), ("ADDED", "b")]


@pytest.mark.parametrize("status", [401, 403, 404])
def test_a_right_that_was_taken_away_ends_the_watch(serve: Any, status: int) -> None:
    """Asking for ever would hide it."""
    answers = [listed(7, pod("a", 3)), lambda exchange: exchange.say(status, {"message": "no"})]
    with pytest.raises(ClusterError, match="cannot watch Pods: no"):
        follow(serve, *answers, *answers, events=9)


def test_a_server_that_is_away_for_a_moment_is_asked_again(serve: Any) -> None:
    """It restarts during an upgrade; but a first list that fails is an error."""
    seen, _ = follow(
        serve,
        listed(7, pod("a", 3)),
        lambda exchange: exchange.hang_up(),
        lambda exchange: exchange.say(500, b""),
        stream(event("DELETED", pod("a", 9))),
        events=2,
    )
    assert seen == [("ADDED", "a"), ("DELETED", "a")]
    with pytest.raises(ClusterError):
        follow(serve, lambda exchange: exchange.say(500, b""), events=1)


def test_a_watch_ends_in_time_or_when_it_is_cancelled(
    serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though nothing happens and the server does not end it."""
    monkeypatch.setattr(watching, "SILENCE", 0.0)
    started = time.monotonic()
    assert follow(serve, listed(7), events=1, seconds=0.1)[0] == []
    cancel = threading.Event()
    threading.Timer(0.05, cancel.set).start()
    assert follow(serve, listed(7), events=1, cancel=cancel)[0] == []
    assert time.monotonic() - started < 10

"""Answers that no API server gives: one clear error each, and never something of another shape."""

from __future__ import annotations

import json
import traceback
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import transport as resending
from rigel_k8s.kube import watching
from rigel_k8s.kube.failures import Garbled, Missing, refusal
from rigel_k8s.kube.target import Credentials
from tests.support.http_server import Exchange

from .conftest import MANIFEST, REF

GARBAGE = {
    "empty": b"",
    "bad UTF-8": b'{"metadata": {"name": "\xff\xfe"}}',
    "HTML": b"<html><body>Please log in</body></html>",
    "null": b"null",
    "a list": b"[]",
    "text": b'"ok"',
    "a number": b"1",
    "truncated": json.dumps(MANIFEST).encode()[:40],
    "nested": b"[" * 100_000,
    "no metadata": b'{"kind": "ConfigMap"}',
    "metadata of text": b'{"metadata": "c"}',
    "no name": b'{"metadata": {}}',
    "labels of text": b'{"metadata": {"name": "c", "labels": "x"}}',
    "annotations in a list": b'{"metadata": {"name": "c", "annotations": ["x"]}}',
    "a number as version": b'{"metadata": {"name": "c", "resourceVersion": 7}}',
    "status of text": b'{"metadata": {"name": "c"}, "status": "fine"}',
    "data in a list": b'{"metadata": {"name": "c"}, "data": [1]}',
}
CALLS = {
    "get": lambda cluster: cluster.get(REF),
    "list": lambda cluster: cluster.list("v1", "ConfigMap", "robot"),
    "apply": lambda cluster: cluster.apply(MANIFEST),
    "create": lambda cluster: cluster.create(MANIFEST),
    "replace": lambda cluster: cluster.replace(MANIFEST),
    "patch": lambda cluster: cluster.patch(REF, {"data": {"a": "1"}}),
    "watch": lambda cluster: list(cluster.watch("v1", "ConfigMap", "robot", seconds=20)),
    "version": lambda cluster: cluster.server_version(),
}
#: What is answered without an object of its own; a login page must not look like success there.
OTHER_CALLS = {
    "delete": lambda cluster: cluster.delete(REF),
    "look for a kind": lambda cluster: cluster.serves("x.example/v1", "Robot"),
    "review": lambda cluster: cluster.review("authorization.k8s.io/v1", "SelfSubjectReview", {}),
}
NO_SUCCESS = {
    **{name: GARBAGE[name] for name in ("empty", "bad UTF-8", "HTML", "null", "a list", "text")},
    **{name: GARBAGE[name] for name in ("truncated", "nested")},
    "a bare object": b'{"kind": "Thing"}',
    "a failure": b'{"kind": "Status", "status": "Failure"}',
}


@pytest.mark.parametrize("body", GARBAGE.values(), ids=GARBAGE)
@pytest.mark.parametrize("call", CALLS)
def test_garbage_is_one_error_that_shows_where_it_came_from(
    serve: Any, call: str, body: bytes
) -> None:
    """With the URL and the first bytes."""
    client, server = serve(lambda exchange: exchange.say(200, body))
    with pytest.raises(Garbled, match="is not valid: it") as caught:
        CALLS[call](client)
    assert server.url in caught.value.message
    assert caught.value.exit_code == 1
    assert len("".join(caught.value.details)) < 250
    assert bool(caught.value.details) == bool(body)


@pytest.mark.parametrize("body", NO_SUCCESS.values(), ids=NO_SUCCESS)
@pytest.mark.parametrize("call", OTHER_CALLS)
def test_garbage_is_no_success(serve: Any, call: str, body: bytes) -> None:
    """Nothing is deleted, allowed or unknown because a login page said 200."""
    client, _ = serve(lambda exchange: exchange.say(200, body))
    with pytest.raises(Garbled):
        OTHER_CALLS[call](client)


@pytest.mark.parametrize(
    "items", [b"", b', "items": "x"', b', "items": [null]', b', "items": [{"kind": "Pod"}]']
)
def test_a_list_without_a_list_of_objects_is_not_empty(serve: Any, items: bytes) -> None:
    """Otherwise a release would seem to have nothing on the cluster."""
    client, _ = serve(lambda exchange: exchange.say(200, b'{"metadata": {}' + items + b"}"))
    with pytest.raises(Garbled):
        client.list("v1", "Pod")


@pytest.mark.parametrize(
    ("page", "why"),
    [
        (b'{"metadata": {}, "items": []}', "no resourceVersion"),
        (
            b'{"metadata": {"resourceVersion": "1"}, "items": [{"metadata": {"name": "p"}}]}',
            "no uid",
        ),
    ],
)
def test_a_watch_begins_with_a_version_and_uids(serve: Any, page: bytes, why: str) -> None:
    """Without the one it cannot go on, without the others it cannot know what is gone."""
    client, _ = serve(lambda exchange: exchange.say(200, page))
    with pytest.raises(Garbled, match=why):
        list(client.watch("v1", "Pod", seconds=20))


@pytest.mark.parametrize("entry", [{"kind": "Robot"}, {"name": "robots"}, {"name": 1, "kind": "R"}])
def test_a_kind_has_a_name(serve: Any, entry: object) -> None:
    client, _ = serve(lambda exchange: exchange.say(200, {"resources": [entry]}))
    with pytest.raises(Garbled, match="a resource without a name"):
        client.serves("x.example/v1", "Robot")


def test_no_error_shows_the_bytes_of_secrets(serve: Any) -> None:
    """What is cut off in the middle may hold one."""
    client, _ = serve(lambda exchange: exchange.say(200, b'{"data": {"password": "cGxhbnRlZA'))
    with pytest.raises(Garbled) as caught:
        client.list("v1", "Secret", "robot")
    assert "cGxh" not in f"{caught.value.message} {caught.value.details}"
    assert "it may contain a secret" in caught.value.details[0]


@pytest.mark.parametrize("status", [200, 401, 403, 404, 500])
@pytest.mark.parametrize("call", ["get", "apply", "watch", "exec"])
@pytest.mark.parametrize("header", ["Bearer planted-token", "Basic cGxhbnRlZDpwdw=="])
def test_an_answer_that_repeats_our_credentials_is_shown_without_them(
    serve: Any, call: str, status: int, header: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page of a proxy may show the headers of the request."""
    for name in ("RETRY_BUDGET", "FIRST_PAUSE"):
        monkeypatch.setattr(resending, name, 0.01)
    monkeypatch.setattr(watching, "PAUSE", 0.01)

    def answer(exchange: Exchange) -> None:
        exchange.say(status, f"<p>{exchange.headers['Authorization']}</p>".encode())

    me = Credentials(headers=lambda *, fresh: [("Authorization", header)])
    cluster, server = serve(answer, credentials=lambda: me)
    run = {"exec": lambda cluster: cluster.run("n", "pod", ["true"], container="c")}
    with pytest.raises(ClusterError) as caught:
        (CALLS | run)[call](cluster)
    assert server.requests[-1].headers["Authorization"] == header
    told = "".join(traceback.format_exception(caught.value))
    told += f"{caught.value.details} {caught.value.hint}"
    assert "***" in told
    assert header.split()[1] not in told


@pytest.mark.parametrize("call", ["get", "apply", "create", "replace", "patch"])
def test_what_is_garbled_once_is_asked_again(serve: Any, call: str) -> None:
    """A write may have been carried out: it is sent again, and then is what we sent."""

    def answer(exchange: Exchange) -> None:
        first = len(exchange.server.requests) == 1
        exchange.say(200, b"<html>" if first else MANIFEST)

    client, server = serve(answer)
    assert CALLS[call](client) == MANIFEST
    assert len(server.requests) == 2


def test_steps_on_what_was_there_are_not_asked_again(serve: Any) -> None:
    """They may have been carried out."""
    client, server = serve(lambda exchange: exchange.say(200, b"<html>"))
    with pytest.raises(Garbled):
        client.client.write("PATCH", "/api/v1/c", "add an item", [], safe=False)
    assert len(server.requests) == 1


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"<html>",
        b"null",
        b"[]",
        b"\xff",
        b'{"details": []}',
        b'{"details": "x"}',
        b'{"details": {"causes": "x"}}',
        b'{"details": {"causes": [null, {"reason": 1, "message": null}]}}',
        b'{"message": ["x"], "reason": {}}',
        b"[" * 100_000,
    ],
)
@pytest.mark.parametrize("status", [400, 401, 403, 404, 409, 422, 500])
def test_a_refusal_may_say_anything(status: int, body: bytes) -> None:
    """It is an error in one line all the same."""
    error = refusal(status, body, "list Pods", context="", server="https://k")
    assert error.status == status
    assert "\n" not in error.message
    assert all(isinstance(cause.message, str) for cause in error.causes)


def test_a_page_that_is_not_found_is_no_missing_object(serve: Any) -> None:
    """A proxy's 404 does not say that an object is gone; the API server's own one does."""
    assert not isinstance(refusal(404, b"<html>", "x", context="", server=""), Missing)
    assert isinstance(refusal(404, b"404 page not found\n", "x", context="", server=""), Missing)
    client, _ = serve(lambda exchange: exchange.say(404, b"<h1>Not found</h1>"))
    with pytest.raises(ClusterError, match="Not found"):
        client.get(REF)


LISTED = {"metadata": {"resourceVersion": "7"}, "items": []}
EVENTS = (
    b"null",
    b"[]",
    b"<html>",
    b"{}",
    b'{"type": "ADDED"}',
    b'{"type": "ADDED", "object": null}',
    b'{"type": "ADDED", "object": {"metadata": {"name": "a"}}}',
    b'{"type": "MOVED", "object": {"metadata": {"name": "a", "uid": "1"}}}',
    b'{"type": "ERROR", "object": []}',
    b'{"type": "BOOKMARK", "object": {}}',
    b"\xff\xfe",
)


@pytest.mark.parametrize("event", EVENTS)
def test_a_watch_survives_garbage_for_a_while(
    serve: Any, monkeypatch: pytest.MonkeyPatch, event: bytes
) -> None:
    """It is opened again where it was; garbage and nothing else is an error."""
    monkeypatch.setattr(watching, "PAUSE", 0.01)
    good = {"type": "ADDED", "object": {"metadata": {"name": "a", "uid": "u", "x": 1}}}
    lives = [event, event, good]

    def answer(exchange: Exchange) -> None:
        if not exchange.request_.query.get("watch"):
            exchange.say(200, LISTED)
            return
        line = lives.pop(0) if lives else event
        exchange.stream(line + b"\n" if isinstance(line, bytes) else line, b"")

    client, server = serve(answer)
    watched = client.watch("v1", "Pod", "n", seconds=20)
    assert next(watched).object["metadata"]["name"] == "a"
    with pytest.raises(Garbled, match="cannot watch Pods"):
        next(watched)
    assert len(server.requests) == 1 + 3 + watching.LIVES


def test_an_error_event_may_say_anything(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A code that is text is no code: the watch goes on where it was."""
    monkeypatch.setattr(watching, "PAUSE", 0.01)
    odd = [{"code": "x"}, {"code": None, "message": []}, {}]
    good = {"type": "ADDED", "object": {"metadata": {"name": "a", "uid": "u"}}}

    def answer(exchange: Exchange) -> None:
        if not exchange.request_.query.get("watch"):
            exchange.say(200, LISTED)
        else:
            exchange.stream({"type": "ERROR", "object": odd.pop()} if odd else good, b"")

    client, _ = serve(answer)
    assert next(client.watch("v1", "Pod", "n", seconds=20)).type == "ADDED"

"""Who may ask the server of `rigel ui`, and what: each way in is tried as an attacker would."""

from __future__ import annotations

import hmac
import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import websocket

from rigel_k8s.release.types import Revision
from tests.support.manifests import RELEASE
from tests.support.page import TOKEN, Served, fill, node, receive, serve_page
from tests.support.until import until

PAGE = Path(__file__).parents[3] / "src" / "rigel_k8s" / "ui" / "page"
JSON = "application/json"


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    """A server that reads only."""
    with serve_page() as made:
        fill(made.feed, [node("/talker")])
        yield made


@pytest.fixture
def rolled() -> list[int]:
    """The revisions that were rolled back to."""
    return []


@pytest.fixture
def changeable(rolled: list[int]) -> Iterator[Served]:
    """A server that rolls back."""

    def rollback(number: int, report: Any, cancel: threading.Event) -> Revision:
        rolled.append(number)
        report.line("applied")
        return Revision(RELEASE, 7, "good", "", (), (), description=f"rollback to {number}")

    with serve_page(rollback=rollback) as made:
        yield made


def test_the_page_and_its_files_are_served(served: Served) -> None:
    """Each with its type."""
    page = served.ask()
    assert (page.status, page.headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert page.body == (PAGE / "index.html").read_bytes()
    script = served.ask(f"/{TOKEN}/lib/dagre.js")
    assert (script.status, script.headers["content-type"]) == (
        200,
        "text/javascript; charset=utf-8",
    )


# Without the token.


@pytest.mark.parametrize(
    "path",
    [
        *("/", "/live", "/index.html", "//", f"/{TOKEN[:-1]}/", f"/{TOKEN}x/", f"//{TOKEN[1:]}/"),
        *("/open/", "/open/x", f"/x/{TOKEN}/", f"/?token={TOKEN}", f"/%2e/{TOKEN[:-1]}/"),
        "/%C3%A4/",
    ],
)
def test_without_the_token_nothing_is_served(served: Served, path: str) -> None:
    """The answer says what to open, and nothing of the release."""
    answer = served.ask(path)
    assert answer.status == 403
    assert b"rigel ui" in answer.body
    assert TOKEN.encode() not in answer.body


def test_the_token_is_compared_in_constant_time(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    """How long an answer takes says nothing of how much of a guess is right."""
    compared = []
    real = hmac.compare_digest

    def compare(one: bytes, other: bytes) -> bool:
        compared.append({one, other})
        return real(one, other)

    monkeypatch.setattr("rigel_k8s.ui.server.hmac.compare_digest", compare)
    assert served.ask("/guess/").status == 403
    assert compared == [{b"guess", TOKEN.encode()}]


@pytest.mark.parametrize("path", ["/live", f"/{TOKEN[:-1]}/live", "/open/x"])
def test_without_the_token_no_page_is_connected(served: Served, path: str) -> None:
    """A websocket is refused before it opens."""
    with pytest.raises(websocket.WebSocketBadStatusException) as caught:
        served.connect(path)
    assert caught.value.status_code == 403


def test_a_ticket_opens_the_page_once(served: Served) -> None:
    """What a browser's command line shows is worth nothing afterwards."""
    ticket = served.tickets.issue()
    answer = served.ask(f"/open/{ticket}")
    assert (answer.status, answer.headers["location"]) == (303, f"/{TOKEN}/")
    assert served.ask(f"/open/{ticket}").status == 403


def test_a_ticket_that_is_late_is_refused(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """The browser has a minute."""
    monkeypatch.setattr("rigel_k8s.ui.server.TICKET", -1.0)
    assert served.ask(f"/open/{served.tickets.issue()}").status == 403


def test_only_this_machine_reaches_it(served: Served) -> None:
    """It listens on 127.0.0.1, so on no other address of the loopback either."""
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.2", served.port), timeout=5)


# From a page of another site, in the same browser.


@pytest.mark.parametrize(
    "host",
    [
        *("attacker.example", "attacker.example:{port}", "localhost.attacker.example:{port}"),
        *("127.0.0.1.attacker.example", "127.0.0.1@attacker.example", "127.0.0.1:80:80"),
        *("", "[::1", "127.0.0.1/", "2130706433"),
    ],
)
def test_a_rebound_name_is_refused(served: Served, host: str) -> None:
    """Even with the token, which such a page does not have."""
    host = host.format(port=served.port)
    assert served.ask(host=host).status == 421
    if host:  # without one, the client names the address
        with pytest.raises(websocket.WebSocketBadStatusException):
            served.connect(host=host, origin=f"http://{host}")


@pytest.mark.parametrize(
    "host", ["127.0.0.1:{port}", "localhost:9000", "127.0.0.1", "[::1]:{port}"]
)
def test_a_tunnel_may_have_another_port(served: Served, host: str) -> None:
    """`ssh -L 9000:127.0.0.1:PORT` leads here from another machine."""
    assert served.ask(host=host.format(port=served.port)).status == 200


@pytest.mark.parametrize("origin", ["https://attacker.example", "null", "http://127.0.0.1:1"])
def test_another_site_cannot_connect(served: Served, origin: str) -> None:
    """Browsers let any page open a websocket to anywhere: the origin tells."""
    with pytest.raises(websocket.WebSocketBadStatusException):
        served.connect(origin=origin)


def test_a_connection_without_origin_is_refused(served: Served) -> None:
    """No browser opens one."""
    with pytest.raises(websocket.WebSocketBadStatusException):
        served.connect(origin=None)


def test_every_answer_has_the_policy(served: Served) -> None:
    """Of pages, files and refusals alike; it lets in nothing from elsewhere, and no inline code."""
    for path in (f"/{TOKEN}/", f"/{TOKEN}/app.js", f"/{TOKEN}/missing", "/"):
        headers = served.ask(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
        assert "http" not in policy
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cache-control"] == "no-store"
        assert "server" not in headers
        assert "access-control-allow-origin" not in headers


@pytest.mark.parametrize(
    "path",
    [
        *("../server.py", "..%2fserver.py", "%2e%2e/server.py", "lib/../../server.py"),
        *("lib", "lib/", "/etc/passwd"),
    ],
)
def test_no_other_file_is_served(served: Served, path: str) -> None:
    """Files are looked up by name in what was read at the start."""
    assert served.ask(f"/{TOKEN}/{path}").status in (403, 404)


# Writing.


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"])
def test_without_allow_changes_nothing_writes(served: Served, method: str) -> None:
    """Whatever the page's own script sends."""
    for path in ("rollback", "", "live", "index.html"):
        answer = served.ask(
            f"/{TOKEN}/{path}", method, b'{"revision": 1}', origin=f"http://{served.host}",
            content_type=JSON,
        )  # fmt: skip
        assert answer.status in (404, 405), (method, path)


def ask_rollback(served: Served, body: bytes = b'{"revision": 3}', **headers: str) -> int:
    own = {"origin": f"http://{served.host}", "content_type": JSON, **headers}
    return served.ask(f"/{TOKEN}/rollback", "POST", body, **own).status


def test_a_rollback_is_carried_out_and_told(changeable: Served, rolled: list[int]) -> None:
    """All pages see how it goes."""
    page = changeable.connect()
    receive(page)
    assert ask_rollback(changeable) == 202
    told = []
    while not told or told[-1]["state"] == "running":
        told.append(receive(page)["set"]["change"])
    assert rolled == [3]
    assert told[-1] == {
        "to": 3, "state": "done", "message": "revision 7: rollback to 3", "lines": ["applied"]
    }  # fmt: skip
    page.close()


@pytest.mark.parametrize(
    "headers",
    [{"origin": "https://attacker.example"}, {"origin": "null"}, {"origin": ""},
     {"content_type": "text/plain"}, {"content_type": "application/x-www-form-urlencoded"},
     {"host": "attacker.example"}, {"host": "attacker.example", "origin": "http://attacker.example"}],
)  # fmt: skip
def test_another_site_cannot_roll_back(
    changeable: Served, rolled: list[int], headers: dict[str, str]
) -> None:
    """A form or a simple request of another page is refused, even if it had the token."""
    assert ask_rollback(changeable, **headers) in (400, 403, 421)
    assert changeable.ask(f"/{TOKEN}/rollback", "GET").status == 404  # a file that is not there
    assert rolled == []


@pytest.mark.parametrize(
    "body",
    [b"", b"3", b"null", b"{}", b'{"revision": "3"}', b'{"revision": true}', b'{"revision": 0}',
     b'{"revision": -1}', b'{"revision": 1.5}', b"\xff", b'{"revision": 3' + b" " * 2000 + b"}"],
)  # fmt: skip
def test_a_rollback_names_a_revision(changeable: Served, rolled: list[int], body: bytes) -> None:
    """Anything else is refused."""
    assert ask_rollback(changeable, body) == 400
    assert rolled == []


def test_one_rollback_at_a_time() -> None:
    """A second one is refused while the first goes on; the end of the server interrupts it."""
    cancelled = []

    def rollback(number: int, report: Any, cancel: threading.Event) -> Revision:
        cancelled.append(cancel.wait(20))
        return Revision(RELEASE, 7, "good", "", (), ())

    with serve_page(rollback=rollback) as served:
        assert ask_rollback(served) == 202
        assert ask_rollback(served) == 409
    assert cancelled == [True]


# What a page sends and gets.


def test_a_page_gets_everything_and_then_changes(served: Served) -> None:
    """A change is sent alone."""
    page = served.connect()
    first = receive(page)["all"]
    assert first["node/talker"]["state"] == "ready"
    assert first["server"] == {"changes": False}
    served.feed.publish("graph", {"graph": {"message": "later", "read": ""}})
    assert receive(page) == {"set": {"graph": {"message": "later", "read": ""}}, "gone": []}
    page.close()


@pytest.mark.parametrize(
    "text", ["", "x", "[]", '{"follow": "a", "more": 1}', '{"run": "rm"}', '"follow"', "9" * 2000]
)
def test_a_page_that_says_anything_else_is_closed(served: Served, text: str) -> None:
    """And the server goes on."""
    page = served.connect()
    receive(page)
    page.send(text)
    assert page.recv_data()[0] == websocket.ABNF.OPCODE_CLOSE
    page.shutdown()
    assert served.ask().status == 200


def test_a_page_that_has_gone_is_forgotten(served: Served) -> None:
    """Nothing is kept for it."""
    page = served.connect()
    receive(page)
    page.send(json.dumps({"follow": "talker"}))
    until(lambda: served.feed.watched and served.logs.count() == 1, "the page's log", 20)
    page.shutdown()
    until(lambda: not served.feed.watched and served.logs.count() == 0, "the page to be gone", 20)

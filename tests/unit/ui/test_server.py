"""Who may ask the server of `rigel ui`, and what: each way in is tried as an attacker would."""

from __future__ import annotations

import hashlib
import hmac
import json
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.release.types import Revision
from rigel_ui.readings import MOST
from tests.support.manifests import RELEASE
from tests.support.page import TOKEN, Served, fill, node, serve_page
from tests.support.until import until

PAGE = Path(__file__).parents[3] / "src" / "rigel_ui" / "page"
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
    script = served.ask(f"/{TOKEN}/lib/viz.js")
    assert (script.status, script.headers["content-type"]) == (
        200,
        "text/javascript; charset=utf-8",
    )


def test_what_others_wrote_is_the_file_that_the_notice_names() -> None:
    """Unchanged, and the only one."""
    library = PAGE / "lib"
    assert {path.name for path in library.iterdir()} == {"viz.js", "NOTICE"}
    digest = hashlib.sha256((library / "viz.js").read_bytes()).hexdigest()
    assert digest in (library / "NOTICE").read_text("utf-8")


# Without the token.


@pytest.mark.parametrize(
    "path",
    [
        *("/", "/live", "/index.html", "//", f"/{TOKEN[:-1]}/", f"/{TOKEN}x/", f"//{TOKEN[1:]}/"),
        *(
            f"/{TOKEN[:-1]}/live",
            "/open/",
            "/open/x",
            f"/x/{TOKEN}/",
            f"/?token={TOKEN}",
            f"/%2e/{TOKEN[:-1]}/",
        ),
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

    monkeypatch.setattr("rigel_ui.server.hmac.compare_digest", compare)
    assert served.ask("/guess/").status == 403
    assert compared == [{b"guess", TOKEN.encode()}]


def test_a_ticket_opens_the_page_once(served: Served) -> None:
    """What a browser's command line shows is worth nothing afterwards."""
    ticket = served.tickets.issue()
    answer = served.ask(f"/open/{ticket}")
    assert (answer.status, answer.headers["location"]) == (303, f"/{TOKEN}/")
    assert served.ask(f"/open/{ticket}").status == 403


def test_a_ticket_that_is_late_is_refused(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """The browser has a minute."""
    monkeypatch.setattr("rigel_ui.server.TICKET", -1.0)
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
    for path in (f"/{TOKEN}/", f"/{TOKEN}/live"):
        assert served.ask(path, host=host).status == 421
        assert served.ask(path, host=host, origin=f"http://{host}").status == 421


@pytest.mark.parametrize(
    "host", ["127.0.0.1:{port}", "localhost:9000", "127.0.0.1", "[::1]:{port}"]
)
def test_a_tunnel_may_have_another_port(served: Served, host: str) -> None:
    """`ssh -L 9000:127.0.0.1:PORT` leads here from another machine."""
    assert served.ask(host=host.format(port=served.port)).status == 200


@pytest.mark.parametrize("origin", ["https://attacker.example", "null", "http://127.0.0.1:1"])
def test_another_site_cannot_read(served: Served, origin: str) -> None:
    """Browsers send the origin of a page that reads another server's answers."""
    for path in ("", "live"):
        assert served.ask(f"/{TOKEN}/{path}", origin=origin).status == 403


def test_every_answer_has_the_policy(served: Served) -> None:
    """Of pages, files and refusals alike; it lets in nothing from elsewhere, and no inline code."""
    for path in (f"/{TOKEN}/", f"/{TOKEN}/app.js", f"/{TOKEN}/missing", "/"):
        headers = served.ask(path).headers
        policy = headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert policy.count("unsafe") == policy.count("'wasm-unsafe-eval'") == 1
        assert "trusted-types 'none'" in policy
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
    page.receive()
    assert ask_rollback(changeable) == 202
    told = []
    while not told or told[-1]["state"] == "running":
        told.append(page.receive()["set"]["change"])
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
     b'{"revision": -1}', b'{"revision": 1.5}', b"\xff", b'{"revision": 3' + b" " * 2000 + b"}",
     b"[" * 1000, b'{"revision": ' + b"9" * 900 + b"}"],
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


@pytest.mark.parametrize("length", ["", "x", "-1", "9" * 5000, "2000"])
def test_a_body_that_is_not_announced_or_too_long_is_not_read(
    changeable: Served, rolled: list[int], length: str
) -> None:
    """The answer does not wait for it."""
    assert ask_rollback(changeable, content_length=length) == 400
    assert rolled == []


# Reading once.


@pytest.fixture
def asked() -> list[str]:
    """The topics that were read."""
    return []


@pytest.fixture
def readable(asked: list[str]) -> Iterator[Served]:
    """A server that writes nothing, and reads messages."""

    def read(name: str) -> dict[str, Any]:
        asked.append(name)
        if name == "/silent":
            raise ClusterError("no message", hint="wait", details=["a cause"])
        return {"text": "data: 1", "shortened": False}

    with serve_page(kinds={"message": read}) as made:
        yield made


def test_a_page_that_only_reads_may_ask_for_a_message(readable: Served, asked: list[str]) -> None:
    """A failure is an answer as well, with its details and the hint."""
    answer = readable.ask(f"/{TOKEN}/message?name=%2Fa%26b")
    found = json.loads(answer.body)
    assert (answer.status, answer.headers["content-type"], asked) == (200, JSON, ["/a&b"])
    assert found.pop("read").endswith("Z")
    assert found == {"text": "data: 1", "shortened": False}
    answer = readable.ask(f"/{TOKEN}/message?name=/silent")
    assert json.loads(answer.body) == {"error": "no message\na cause\nwait"}


@pytest.mark.parametrize(
    ("status", "method", "path", "headers"),
    [
        (403, "GET", "/wrong/message?name=/a", {}),
        (403, "GET", f"/{TOKEN}/message?name=/a", {"origin": "https://attacker.example"}),
        (421, "GET", f"/{TOKEN}/message?name=/a", {"host": "attacker.example"}),
        (405, "POST", f"/{TOKEN}/message?name=/a", {}),
        (404, "HEAD", f"/{TOKEN}/message?name=/a", {}),
        (404, "GET", f"/{TOKEN}/message?name=", {}),
        (404, "GET", f"/{TOKEN}/parameters?name=/a", {}),  # this server does not read them
    ],
)
def test_nothing_else_reads(
    readable: Served, asked: list[str], status: int, method: str, path: str, headers: dict[str, str]
) -> None:
    """Each reading starts a program in a pod: no one but the page may do that."""
    if method == "POST":
        headers = {"origin": f"http://{readable.host}"}
    assert readable.ask(path, method, **headers).status == status
    assert asked == []


def test_a_few_readings_at_a_time() -> None:
    """Pages that ask for more keep neither the pods busy nor the browser's connections."""
    free, begun = threading.Event(), threading.Semaphore(0)

    def read(name: str) -> dict[str, Any]:
        begun.release()
        free.wait(60)
        return {}

    answers: list[Any] = []
    with serve_page(kinds={"message": read}) as served:

        def ask() -> None:
            answers.append(json.loads(served.ask(f"/{TOKEN}/message?name=/a").body))

        threads = [threading.Thread(target=ask) for _ in range(MOST)]
        for one in threads:
            one.start()
        for _ in threads:
            assert begun.acquire(timeout=20)
        ask()
        assert "4 other readings are in progress" in answers[0]["error"]
        assert served.ask().status == 200
        free.set()
        for one in threads:
            one.join(20)
        ask()
    assert [set(one) for one in answers[1:]] == [{"read"}] * (MOST + 1)


# What a page gets.


def test_a_page_gets_everything_and_then_changes(served: Served) -> None:
    """A change is sent alone."""
    page = served.connect()
    first = page.receive()["all"]
    assert first["node/talker"]["state"] == "ready"
    assert first["server"] == {"changes": False}
    served.feed.publish("graph", {"graph": {"message": "later", "read": ""}})
    assert page.receive() == {"set": {"graph": {"message": "later", "read": ""}}, "gone": []}
    page.close()


def test_a_page_in_the_background_holds_no_connection(served: Served) -> None:
    """It gets everything, and when to come back."""
    answer = served.ask(f"/{TOKEN}/live?behind=yes")
    retry, data = answer.body.decode().split("\n", 1)
    assert retry == "retry: 5000"
    assert json.loads(data.removeprefix("data: "))["all"]["node/talker"]["state"] == "ready"


def test_a_page_that_has_gone_is_forgotten(served: Served) -> None:
    """Nothing is kept for it."""
    page = served.connect("?follow=talker")
    page.receive()
    until(lambda: served.feed.watched and served.logs.count() == 1, "the page's log", 20)
    page.close()
    until(lambda: not served.feed.watched and served.logs.count() == 0, "the page to be gone", 20)


def test_pages_that_never_read_are_dropped(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """The feed does not wait for them, and others are served meanwhile."""
    monkeypatch.setattr("rigel_ui.server.Handler.timeout", 0.5)
    pages = []
    for _ in range(20):
        one = socket.create_connection(("127.0.0.1", served.port), timeout=20)
        one.sendall(f"GET /{TOKEN}/live HTTP/1.1\r\nHost: {served.host}\r\n\r\n".encode())
        pages.append(one)
    until(lambda: len(served.feed._pages) == 20, "the pages")
    monkeypatch.setattr("rigel_ui.server.Handler.timeout", 60)  # of the one that reads
    for number in range(200):
        served.feed.publish("graph", {"graph": {"message": "x" * 100_000, "read": number}})
    assert served.ask().status == 200
    until(lambda: not served.feed.watched, "their end")
    for one in pages:
        one.close()


def test_half_a_request_does_not_stay(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever connects and sends nothing more loses the connection, and keeps no one else out."""
    monkeypatch.setattr("rigel_ui.server.Handler.timeout", 1.0)
    waiting = []
    for _ in range(100):
        one = socket.create_connection(("127.0.0.1", served.port), timeout=60)
        one.sendall(f"GET /{TOKEN}/ HTTP/1.1\r\nHost:".encode())
        waiting.append(one)
    assert served.ask().status == 200
    for one in waiting:
        assert one.recv(1) == b""
        one.close()


@pytest.mark.parametrize(
    "request_line",
    [b"", b"\x16\x03\x01\x02", b"GET", b"GET / HTTP/9.9", b"G" * 70_000, b"X / HTTP/1.1"],
)
def test_what_is_not_http_gets_no_token(
    served: Served, request_line: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    """And nothing of it is printed."""
    with socket.create_connection(("127.0.0.1", served.port), timeout=20) as one:
        one.sendall(request_line + b"\r\n\r\n")
        one.shutdown(socket.SHUT_WR)
        answer = b""
        try:
            while part := one.recv(65536):
                answer += part
        except ConnectionResetError:
            pass
    assert TOKEN.encode() not in answer
    assert capfd.readouterr() == ("", "")
    assert served.ask().status == 200

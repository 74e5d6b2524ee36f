"""HTTP against a real, small server: kept connections, retries, streams, proxies."""

from __future__ import annotations

import http.server
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any
from urllib.parse import urlsplit

import pytest

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.kube.proxy import proxy_for
from rigel_k8s.kube.target import Target
from rigel_k8s.kube.transport import Stream, Transport

Handler = Callable[["Server"], None]


class Server(http.server.BaseHTTPRequestHandler):
    """Answers as the test's function says; remembers requests and connections."""

    protocol_version = "HTTP/1.1"
    answer: Handler
    requests: list[str]
    peers: set[Any]

    def do_GET(self) -> None:
        self.peers.add(self.client_address)
        length = int(self.headers.get("Content-Length") or 0)
        body = self.rfile.read(length).decode()
        self.requests.append(f"{self.command} {self.path} {body}".strip())
        type(self).answer(self)

    do_POST = do_PATCH = do_GET

    def say(self, status: int, body: bytes, **headers: str) -> None:
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *args: object) -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[Callable[[Handler], tuple[Transport, type[Server]]]]:
    """Start a server that answers as it is told; return a transport to it."""
    running: list[tuple[http.server.ThreadingHTTPServer, Transport]] = []

    def start(answer: Handler) -> tuple[Transport, type[Server]]:
        handler = type("Own", (Server,), {"answer": answer, "requests": [], "peers": set()})
        listening = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
        listening.daemon_threads = True
        threading.Thread(target=listening.serve_forever, args=(0.01,), daemon=True).start()
        transport = Transport(Target(f"http://127.0.0.1:{listening.server_port}/base", "test"))
        running.append((listening, transport))
        return transport, handler

    yield start
    for listening, transport in running:
        transport.close()
        listening.shutdown()
        listening.server_close()


def test_connections_are_kept(server: Any) -> None:
    """Requests one after the other share one connection; the base path is kept."""
    transport, seen = server(lambda s: s.say(200, b"ok"))
    for _ in range(3):
        assert transport.request("GET", "/x", "test").body == b"ok"
    assert seen.requests == ["GET /base/x"] * 3
    assert len(seen.peers) == 1


def test_a_kept_connection_that_died_is_replaced(server: Any) -> None:
    """The server closed it meanwhile: the request is sent again on a new one."""

    def answer(s: Server) -> None:
        s.say(200, b"ok")
        s.close_connection = True  # without having said so

    transport, seen = server(answer)
    for _ in range(3):
        assert transport.request("PATCH", "/x", "test", body=b"{}", safe=True).status == 200
    assert len(seen.requests) == 3


def test_a_post_whose_fate_is_unknown_is_not_sent_twice(server: Any) -> None:
    """The server took it and died: creating again might make two."""

    def answer(s: Server) -> None:
        s.close_connection = True
        s.connection.close()

    transport, seen = server(answer)
    with pytest.raises(ClusterError, match="does not answer"):
        transport.request("POST", "/x", "create", body=b"{}")
    assert len(seen.requests) == 1


def test_the_server_may_ask_for_patience(server: Any) -> None:
    """429 and 503 with Retry-After are sent again, whatever the method."""
    answers = [(429, "0"), (503, "0")]

    def answer(s: Server) -> None:
        if answers:
            status, after = answers.pop()
            s.say(status, b"", Retry_After=after)
        else:
            s.say(200, b"ok")

    transport, seen = server(answer)
    assert transport.request("POST", "/x", "test", body=b"{}").body == b"ok"
    assert len(seen.requests) == 3


def test_a_refused_token_is_asked_for_anew_once(server: Any) -> None:
    """401: the credentials are made fresh, and then the answer stands."""
    asked: list[bool] = []
    transport, seen = server(lambda s: s.say(401, b"no"))

    def headers(*, fresh: bool) -> list[tuple[str, str]]:
        asked.append(fresh)
        return []

    from rigel_k8s.kube.target import Credentials

    transport.known = Credentials(headers=headers)
    assert transport.request("GET", "/x", "test").status == 401
    assert asked == [False, True]
    assert len(seen.requests) == 2


def test_a_stream_is_read_line_by_line_and_can_be_aborted(server: Any) -> None:
    """Another thread ends a stream on which nothing comes any more."""
    hold = threading.Event()

    def answer(s: Server) -> None:
        s.send_response(200)
        s.send_header("Transfer-Encoding", "chunked")
        s.end_headers()
        s.wfile.write(b"8\r\none\ntwo\n\r\n")
        s.wfile.flush()
        hold.wait(20)

    transport, _ = server(answer)
    stream = transport.stream("/x", "test", timeout=None)
    assert isinstance(stream, Stream)
    lines = stream.lines()
    assert [next(lines), next(lines)] == [b"one", b"two"]
    threading.Timer(0.1, stream.abort).start()
    assert list(lines) == []
    hold.set()


def test_no_server_is_told() -> None:
    """Which one, in which context, and why."""
    gone = Transport(Target("http://127.0.0.1:1", "far"))
    with pytest.raises(
        Refusal, match=r"cluster at http://127\.0\.0\.1:1 does not answer"
    ) as caught:
        gone.request("GET", "/x", "list Pods")
    assert caught.value.reason == "Unreachable"
    assert "context far" in (caught.value.hint or "")


def test_a_url_that_is_none_is_told() -> None:
    """Before any request."""
    with pytest.raises(UserError, match="is no URL of a server"):
        Transport(Target("nonsense", "c"))


@pytest.mark.parametrize(
    ("host", "environ", "proxy"),
    [
        ("k8s.example.com", {}, None),
        ("k8s.example.com", {"HTTPS_PROXY": "http://p:3128"}, "p"),
        ("k8s.example.com", {"https_proxy": "p:3128"}, "p"),
        ("k8s.example.com", {"HTTPS_PROXY": "http://p", "NO_PROXY": "x,.example.com"}, None),
        ("k8s.example.com", {"HTTPS_PROXY": "http://p", "NO_PROXY": "*"}, None),
        ("notexample.com", {"HTTPS_PROXY": "http://p", "NO_PROXY": "example.com"}, "p"),
        ("10.1.2.3", {"HTTPS_PROXY": "http://p", "NO_PROXY": "10.0.0.0/8"}, None),
        ("11.1.2.3", {"HTTPS_PROXY": "http://p", "NO_PROXY": "10.0.0.0/8"}, "p"),
        ("127.0.0.1", {"HTTPS_PROXY": "http://p"}, None),
    ],
)
def test_the_environment_names_the_proxy(
    host: str, environ: dict[str, str], proxy: str | None
) -> None:
    """HTTPS_PROXY and NO_PROXY: names, domains, networks, everything."""
    found = proxy_for("", urlsplit(f"https://{host}:6443"), environ)
    assert (found.hostname if found else None) == proxy


def test_the_kubeconfigs_proxy_wins_and_must_be_one_that_works() -> None:
    """proxy-url; a kind that we cannot use is told."""
    server = urlsplit("https://k:6443")
    found = proxy_for("http://mine:1", server, {"HTTPS_PROXY": "http://p"})
    assert found is not None
    assert found.hostname == "mine"
    with pytest.raises(UserError, match="only http:// proxies"):
        proxy_for("socks5://s:1080", server, {})


def test_a_proxy_is_asked_for_the_server(server: Any) -> None:
    """A request goes through CONNECT, and a proxy that refuses is told."""
    proxy, handler = server(lambda s: s.say(502, b""))
    handler.do_CONNECT = handler.do_GET
    address = proxy.target.server.removesuffix("/base")
    through = Transport(Target("https://far.example.com:8443", "c", proxy=address))
    with pytest.raises(ClusterError, match="Tunnel connection failed: 502"):
        through.request("GET", "/x", "test")
    assert set(handler.requests) == {"CONNECT far.example.com:8443"}


def test_a_post_does_not_meet_a_connection_that_was_closed_while_it_waited(server: Any) -> None:
    """A deploy may pause for minutes; a POST that got no answer cannot be sent again safely."""

    def answer(handler: Server) -> None:
        handler.say(200, b"{}")
        handler.close_connection = True

    transport, own = server(answer)
    for _ in range(3):
        assert transport.request("POST", "/x", "make a thing", body=b"{}").status == 200
        time.sleep(0.05)  # until the server has closed
    assert len(own.requests) == 3
    assert len(own.peers) == 3


def test_an_answer_that_ends_does_not_go_on(server: Any) -> None:
    """With lines in it or without one; it is told as soon as it is over."""
    for body in (b"", b"a line\n"):
        transport, _ = server(lambda s, body=body: s.say(200, body))
        assert not transport.goes_on("/log", 60)


def test_an_answer_that_stays_open_goes_on(server: Any) -> None:
    """Whether it is silent, as a quiet node's log, or never stops; a refusal says nothing."""
    over = threading.Event()

    def talk(s: Server) -> None:
        s.send_response(200)
        s.send_header("Content-Length", "100000000")
        s.end_headers()
        while not over.wait(0.01):
            s.wfile.write(b"line\n")

    for answer in (lambda _: over.wait(30), talk, lambda s: s.say(403, b"no")):
        transport, _ = server(answer)
        assert transport.goes_on("/log", 0.2)
    over.set()
    assert Transport(Target("http://127.0.0.1:1", "test")).goes_on("/log", 1)

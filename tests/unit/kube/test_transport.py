"""HTTP against a real, small server: kept connections, retries, streams, TLS, proxies."""

from __future__ import annotations

import socket
import ssl
import threading
import time
from base64 import b64encode
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import attrs
import pytest

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import transport as module
from rigel_k8s.kube.connections import Stream
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.kube.target import Credentials, Target
from rigel_k8s.kube.transport import Transport
from rigel_k8s.system.tls import proxy_for
from tests.support.certificates import AUTHORITY, Authority
from tests.support.http_server import Exchange, HttpServer, serving


def transport_to(serve: Any, answer: Any, **target: Any) -> tuple[Transport, HttpServer]:
    cluster, server = serve(answer, **target)
    return cluster.client.transport, server


def fine(exchange: Exchange) -> None:
    exchange.say(200, b"ok")


def test_connections_are_kept(serve: Any) -> None:
    """Requests one after the other share one connection; the base path is kept."""
    transport, server = transport_to(serve, fine, base="/base")
    for _ in range(3):
        assert transport.request("GET", "/x", "test").body == b"ok"
    assert server.list_requests() == ["GET /base/x"] * 3
    assert server.connections == 1
    list(stream_of(transport).lines())
    assert server.list_requests()[3:] == ["GET /base/x"]


@pytest.mark.parametrize(("method", "safe"), [("GET", None), ("PATCH", True), ("DELETE", True)])
def test_a_safe_request_whose_answer_is_lost_is_sent_again(
    serve: Any, method: str, safe: Any
) -> None:
    """On a kept connection as on a new one: the server takes it and dies."""
    lost = [2, 3]

    def answer(exchange: Exchange) -> None:
        if len(exchange.server.requests) in lost:
            exchange.hang_up()
        else:
            exchange.say(200, b"ok")

    transport, server = transport_to(serve, answer)
    assert transport.request("GET", "/warm", "test").status == 200
    lost[:] = [2]
    assert transport.request(method, "/x", "test", body=b"{}", safe=safe).status == 200
    assert server.list_requests() == ["GET /warm", f"{method} /x", f"{method} /x"]
    lost[:] = [4, 5]
    with pytest.raises(ClusterError, match="does not answer"):
        transport.request(method, "/y", "test", body=b"{}", safe=safe)
    assert len(server.requests) == 5


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH"])
@pytest.mark.parametrize("kept", [0, 1])
def test_a_write_whose_fate_is_unknown_is_not_sent_twice(
    serve: Any, method: str, kept: int
) -> None:
    """The server took it and died: creating again might make two, on a kept connection too."""

    def answer(exchange: Exchange) -> None:
        if exchange.request_.path == "/warm":
            exchange.say(200, b"ok")
        else:
            exchange.hang_up()

    transport, server = transport_to(serve, answer)
    if kept:
        transport.request("GET", "/warm", "test")
    with pytest.raises(ClusterError, match="does not answer"):
        transport.request(method, "/x", "create", body=b"{}")
    assert server.list_requests()[kept:] == [f"{method} /x"]
    assert server.connections == 1


def test_a_post_does_not_meet_a_connection_that_was_closed_while_it_waited(serve: Any) -> None:
    """A deploy may pause for minutes; a POST that got no answer cannot be sent again safely."""

    def answer(exchange: Exchange) -> None:
        exchange.say(200, b"{}")
        exchange.hang_up()

    transport, server = transport_to(serve, answer)
    for _ in range(3):
        assert transport.request("POST", "/x", "make a thing", body=b"{}").status == 200
        assert server.closed.acquire(timeout=10)
    assert server.list_requests() == ["POST /x"] * 3
    assert server.connections == 3


def test_the_server_may_ask_for_patience(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """429 and 503 with Retry-After are sent again, whatever the method, after the time it names."""
    answers, pauses = [(429, "7"), (503, "2")], []
    monkeypatch.setattr(module.time, "sleep", pauses.append)

    def answer(exchange: Exchange) -> None:
        if answers:
            status, after = answers.pop(0)
            exchange.say(status, b"", Retry_After=after)
        else:
            exchange.say(200, b"ok")

    transport, server = transport_to(serve, answer)
    assert transport.request("POST", "/x", "test", body=b"{}").body == b"ok"
    assert len(server.requests) == 3
    assert pauses == [7, 2]


@pytest.mark.parametrize(
    ("status", "after", "sent"), [(503, "0", 6), (503, "31", 1), (503, None, 1), (422, "0", 1)]
)
def test_patience_ends(serve: Any, status: int, after: str | None, sent: int) -> None:
    """Five times, half a minute in all; only where the server asks for it, and may."""
    headers = {} if after is None else {"Retry_After": after}
    transport, server = transport_to(serve, lambda exchange: exchange.say(status, b"", **headers))
    assert transport.request("GET", "/x", "test").status == status
    assert len(server.requests) == sent


def test_a_refused_token_is_asked_for_anew_once(serve: Any) -> None:
    """401: the credentials are made fresh, and then the answer stands."""
    asked: list[bool] = []

    def headers(*, fresh: bool) -> list[tuple[str, str]]:
        asked.append(fresh)
        return [("Authorization", f"Bearer {'new' if fresh else 'old'}")]

    transport, server = transport_to(
        serve,
        lambda exchange: exchange.say(401, b"no"),
        credentials=lambda: Credentials("", "", headers),
    )
    assert transport.request("GET", "/x", "test").status == 401
    assert asked == [False, True]
    assert [r.headers["Authorization"] for r in server.requests] == ["Bearer old", "Bearer new"]


@pytest.mark.parametrize("way", ["request", "stream"])
def test_headers_that_repeat_arrive_one_by_one(serve: Any, way: str) -> None:
    """Two groups in one header would be one group with an odd name."""
    groups = [("Impersonate-Group", "a"), ("Impersonate-Group", "b")]
    transport, server = transport_to(
        serve, fine, credentials=lambda: Credentials("", "", lambda *, fresh: groups)
    )
    if way == "request":
        transport.request("GET", "/x", "test")
    else:
        list(stream_of(transport).lines())
    assert server.requests[0].headers.get_all("Impersonate-Group") == ["a", "b"]


def stream_of(transport: Transport, **options: Any) -> Stream:
    stream = transport.stream("/x", "test", **{"timeout": None, **options})
    assert isinstance(stream, Stream)
    return stream


def test_a_stream_is_read_line_by_line_and_can_be_aborted(serve: Any) -> None:
    """Another thread ends a stream on which nothing comes any more."""
    hold = threading.Event()

    def answer(exchange: Exchange) -> None:
        exchange.stream(b"one\r\ntw", b"o\nthr")
        hold.wait(20)

    transport, _ = transport_to(serve, answer)
    stream = stream_of(transport)
    lines = stream.lines()
    assert [next(lines), next(lines)] == [b"one", b"two"]
    threading.Timer(0.05, stream.abort).start()
    started = time.monotonic()
    assert list(lines) == []
    assert time.monotonic() - started < 10
    assert (stream.aborted, stream.ended) == (True, False)
    hold.set()


def test_a_stream_that_ends_gives_its_last_line(serve: Any) -> None:
    """Though no newline ends it; but not one that was cut off."""

    def answer(exchange: Exchange) -> None:
        exchange.stream(b"one\ntwo")
        if exchange.request_.path == "/x":
            exchange.chunk(b"")
        exchange.hang_up()

    transport, _ = transport_to(serve, answer)
    assert list(stream_of(transport).lines()) == [b"one", b"two"]
    cut_off = transport.stream("/cut", "test", timeout=None)
    assert isinstance(cut_off, Stream)
    assert list(cut_off.lines()) == [b"one"]


def test_a_stream_that_falls_silent_ends_and_one_that_never_begins_is_an_error(serve: Any) -> None:
    """After the time that the caller gives; a silent log has all the time in the world."""
    hold = threading.Event()

    def answer(exchange: Exchange) -> None:
        if exchange.request_.path == "/x":
            head = b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n"
            exchange.wfile.write(head + b"4\r\none\n\r\n")  # what has begun has its line
        hold.wait(60)

    transport, _ = transport_to(serve, answer)
    stream = stream_of(transport, timeout=0.05)
    assert list(stream.lines()) == [b"one"]
    assert not stream.ended
    with pytest.raises(ClusterError, match="timed out"):
        transport.stream("/silent", "test", timeout=None, patience=0.05)
    hold.set()


def test_a_stream_leaves_kept_connections_alone(serve: Any) -> None:
    """Ending it must not break a request of another thread."""

    def answer(exchange: Exchange) -> None:
        if exchange.request_.path == "/x":
            exchange.stream(b"one\n", b"")
        else:
            exchange.say(200, b"ok")

    transport, server = transport_to(serve, answer)
    transport.request("GET", "/warm", "test")
    stream = stream_of(transport)
    assert list(stream.lines()) == [b"one"]
    stream.abort()
    transport.request("GET", "/warm", "test")
    assert [request.connection for request in server.requests] == [1, 2, 1]


def test_a_stream_that_its_reader_closes_meanwhile_can_be_aborted(
    serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A connection that two threads close at once may be half closed for one of them."""
    transport, _ = transport_to(serve, lambda exchange: exchange.stream(b"one\n", b""))
    stream = stream_of(transport)

    close_it = stream.connection.close

    def close() -> None:
        close_it()
        raise ValueError("I/O operation on closed file.")

    monkeypatch.setattr(stream.connection, "close", close)
    stream.abort()
    assert stream.aborted


def test_a_silent_connection_notices_a_peer_that_is_gone(serve: Any) -> None:
    """A log may say nothing for a day, and its machine may have lost power."""
    hold = threading.Event()

    def answer(exchange: Exchange) -> None:
        exchange.stream()
        hold.wait(20)

    transport, _ = transport_to(serve, answer)
    stream = stream_of(transport)
    assert stream.socket.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
    assert stream.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == 30
    stream.abort()
    hold.set()


# TLS.


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A certificate of its own for 127.0.0.1 and api.example.com, and its key."""
    directory = tmp_path_factory.mktemp("tls")
    names = "subjectAltName=IP:127.0.0.1,DNS:api.example.com\n"
    uses = "keyUsage=critical,digitalSignature,keyCertSign\nsubjectKeyIdentifier=hash\n"
    return Authority(directory).make("test", AUTHORITY + names + uses), directory / "test.key"


@pytest.fixture
def tls(certificate: tuple[Path, Path]) -> ssl.SSLContext:
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(*certificate)
    return context


WAYS = {
    "request": lambda transport: transport.request("GET", "/x", "test").body,
    "stream": lambda transport: b"".join(stream_of(transport).lines()),
    "socket": lambda transport: transport.open_socket("test").close(),
}


@pytest.mark.programs
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    ("target", "error"),
    [
        ({"authority": "own"}, None),
        ({"authority": "own", "server_name": "api.example.com"}, None),
        ({"authority": "own", "server_name": "wrong.example.com"}, "certificate is not trusted"),
        ({}, "certificate is not trusted"),
        ({"insecure": True}, None),
        ({"insecure": True, "server_name": "wrong.example.com"}, None),
    ],
)
def test_the_servers_certificate_is_verified(
    serve: Any,
    certificate: tuple[Path, Path],
    tls: ssl.SSLContext,
    way: str,
    target: dict[str, Any],
    error: str | None,
) -> None:
    """Its issuer and the name; not where the kubeconfig says so. However the server is asked."""
    if "authority" in target:
        target = {**target, "authority": certificate[0].read_text()}
    transport, server = transport_to(serve, fine, tls=tls, **target)
    if error:
        with pytest.raises(ClusterError, match=error):
            WAYS[way](transport)
        assert server.requests == []
    else:
        assert WAYS[way](transport) in (b"ok", None)


def test_an_untrusted_server_is_not_asked_again(
    serve: Any, tls: ssl.SSLContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would show the same certificate."""
    transport, _ = transport_to(serve, fine, tls=tls)
    exchanges = []
    exchange = transport.exchange
    monkeypatch.setattr(
        transport, "exchange", lambda *words: (exchanges.append(words), exchange(*words))[1]
    )
    with pytest.raises(ClusterError, match="certificate is not trusted"):
        transport.request("GET", "/x", "test")
    assert len(exchanges) == 1


def test_the_client_shows_its_certificate(
    serve: Any, certificate: tuple[Path, Path], tls: ssl.SSLContext
) -> None:
    """To a server that lets nobody else in."""
    pem, key = (path.read_text() for path in certificate)
    tls.verify_mode = ssl.CERT_REQUIRED
    tls.load_verify_locations(cadata=pem)
    shown = Credentials(pem, key)
    transport, _ = transport_to(serve, fine, tls=tls, authority=pem, credentials=lambda: shown)
    assert transport.request("GET", "/x", "test").body == b"ok"
    with pytest.raises(ClusterError):
        transport_to(serve, fine, tls=tls, authority=pem)[0].request("GET", "/x", "test")
    wrong = attrs.evolve(shown, key="no key")
    transport, _ = transport_to(serve, fine, tls=tls, authority=pem, credentials=lambda: wrong)
    with pytest.raises(UserError, match="certificates cannot be used"):
        transport.request("GET", "/x", "test")


# Where the server is.


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
    with pytest.raises(UserError, match="is not the URL of a server"):
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
    with pytest.raises(UserError, match="use an http:// proxy"):
        proxy_for("socks5://s:1080", server, {})


@pytest.mark.parametrize("way", WAYS)
def test_a_proxy_is_asked_for_the_server(serve: Any, way: str) -> None:
    """By CONNECT and with the proxy's password; a proxy that refuses is told."""
    with serving(lambda exchange: exchange.say(502, b"")) as proxy:
        address = proxy.url.replace("http://", "http://ann:p%40ss@")
        through = Transport(Target("https://far.example.com:8443", "c", proxy=address))
        with pytest.raises(ClusterError, match="Tunnel connection failed: 502"):
            WAYS[way](through)
        assert set(proxy.list_requests()) == {"CONNECT far.example.com:8443"}
        password = f"Basic {b64encode(b'ann:p@ss').decode()}"
        assert {r.headers["Proxy-Authorization"] for r in proxy.requests} == {password}


@pytest.mark.parametrize("way", WAYS)
def test_a_proxy_carries_tls(
    serve: Any, certificate: tuple[Path, Path], tls: ssl.SSLContext, way: str
) -> None:
    """The certificate is verified for the server's name, not for the proxy's."""
    with serving(lambda exchange: exchange.tunnel(server.server_port)) as proxy:
        pem = certificate[0].read_text()
        _, server = transport_to(serve, fine, tls=tls)
        target = Target(f"https://api.example.com:{server.server_port}", "c", authority=pem)
        through = Transport(attrs.evolve(target, proxy=proxy.url))
        assert WAYS[way](through) in (b"ok", None)
        through.connections.close()
        wrong = Transport(attrs.evolve(target, proxy=proxy.url, server="https://other.example.com"))
        with pytest.raises(ClusterError, match="certificate is not trusted"):
            WAYS[way](wrong)

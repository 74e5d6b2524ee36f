"""HTTP to one API server, on urllib3: its pool for requests, a connection of its own for a stream.

It knows bytes and headers, not what Kubernetes means by them. Threads share the pool; a stream
(watch, logs, a websocket) has its connection to itself, so that another thread can end it.
"""

from __future__ import annotations

import http.client
import os
import socket
import ssl
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, unquote, urlsplit

import attrs
import urllib3
from urllib3.connection import HTTPConnection, HTTPSConnection
from urllib3.exceptions import HTTPError, InsecureRequestWarning

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.failures import Cancelled, unreachable_error
from rigel_k8s.kube.losses import is_sent, is_untrusted, reason_of
from rigel_k8s.kube.resending import Endurance, Resending
from rigel_k8s.kube.target import Credentials, Target
from rigel_k8s.system.proxy import proxy_for
from rigel_k8s.system.tls import trust

CONNECT_TIMEOUT = 10.0
READ_TIMEOUT = 75.0  # the API server itself gives up after 60 seconds
WHOLE_TIMEOUT = 300.0  # seconds until an answer is whole, however slowly it comes
BLOCK = 32 * 1024
BROKEN = (HTTPError, http.client.HTTPException, OSError)
# The kernel notices a peer that is gone while a stream is silent.
ALIVE: list[tuple[int, int, int]] = [(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)]
if hasattr(socket, "TCP_KEEPIDLE"):
    ALIVE += [
        (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 30),
        (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10),
    ]


@attrs.frozen
class Answer:
    """A whole answer.

    Attributes:
        doubtful: the request was sent more than once, and an earlier one may have been carried out.
    """

    status: int
    headers: Mapping[str, str]
    body: bytes
    doubtful: bool = False


class Stream:
    """An answer that goes on: read its lines, abort it from any thread.

    Attributes:
        aborted: we have ended it.
        ended: the server has ended it, after its last byte.
    """

    def __init__(
        self, connection: HTTPConnection, response: urllib3.BaseHTTPResponse, sock: socket.socket
    ):
        self.connection, self.response, self.socket = connection, response, sock
        self.aborted = self.ended = False

    def lines(self) -> Iterator[bytes]:
        """Yield lines without their end until the server or `abort` ends the stream."""
        rest = b""
        try:
            while block := self.response.read1(BLOCK):
                *whole, rest = (rest + block).split(b"\n")
                for line in whole:
                    if self.aborted:
                        return
                    yield line.rstrip(b"\r")
            self.ended = not self.aborted
            if rest and self.ended:
                yield rest
        except (*BROKEN, ValueError, AttributeError):
            return  # aborted, or the connection broke: the caller knows what was still to come
        finally:
            self.abort()

    def abort(self) -> None:
        """End the stream; a thread that reads it returns."""
        self.aborted = True
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)
        with suppress(OSError, ValueError, AttributeError):  # a reader may close it just now
            self.connection.close()


class Transport:
    """All connections to one API server."""

    def __init__(self, target: Target):
        self.target = target
        self.url = urlsplit(target.server)
        if self.url.scheme not in ("http", "https") or not self.url.hostname:
            raise UserError(f"context {target.context}: {target.server!r} is no URL of a server")
        self.proxy = proxy_for(target.proxy, self.url, os.environ)
        self.lock = threading.Lock()
        self.known: Credentials | None = None
        self.tls: ssl.SSLContext | None = None
        self.kept: urllib3.PoolManager | None = None
        self.endurance: Endurance | None = None
        self.guard: Callable[[], None] | None = None  # called before a write is sent again
        self.answered = False
        if target.insecure:
            urllib3.disable_warnings(InsecureRequestWarning)  # the kubeconfig asks for it

    def request(
        self,
        method: str,
        path: str,
        what: str,
        *,
        body: bytes | None = None,
        media: str = "",
        accept: str = "application/json",
        safe: bool | None = None,
        endures: bool = True,
    ) -> Answer:
        """Send a request and return the whole answer, whatever its status is.

        A server that has answered before and is away is waited for where there is an `endurance`.

        Args:
            what: what is asked, for people.
            safe: whether sending it twice is harmless; None is: where the method only reads.
            endures: whether an answer such as 503 means that the server is away.

        Raises:
            ClusterError: there is no answer.
        """
        own = {"Accept": accept, **({"Content-Type": media} if media else {})}
        safe = method == "GET" if safe is None else safe
        again, fresh = Resending(safe, self.is_enduring()), False
        while True:
            if again.is_resent and method != "GET" and self.guard:
                self.guard()
            try:
                answer = self.exchange(method, path, self.headers(own, fresh=fresh), body)
            except BROKEN as error:
                failure = self.unreachable_error(what, error)
                pause = again.after_loss(sent=is_sent(error))
                if pause is None or is_untrusted(error):
                    raise failure from error
                self.pause(pause, again, what, f"does not answer ({reason_of(error)})")
                continue
            if answer.status == 401 and not fresh:
                fresh = True
                continue
            again.endures = again.endures and endures
            pause = again.after_answer(answer.status, answer.headers)
            if pause is None:
                if answer.status < 500 and self.endurance:
                    self.endurance.end()
                return attrs.evolve(answer, doubtful=again.doubtful)
            self.pause(pause, again, what, f"is not available (HTTP status {answer.status})")

    def exchange(
        self, method: str, path: str, headers: urllib3.HTTPHeaderDict, body: bytes | None
    ) -> Answer:
        """Send a request once and return the answer; raises one of BROKEN."""
        end = time.monotonic() + WHOLE_TIMEOUT
        response = self.pool().urlopen(
            method,
            self.target.server + path,
            body=body,
            headers=headers,
            retries=False,
            redirect=False,
            preload_content=False,
        )
        blocks = []
        try:
            while block := response.read1(BLOCK):
                blocks.append(block)
                if time.monotonic() > end:
                    raise TimeoutError(f"the answer was not whole after {WHOLE_TIMEOUT:g} s")
        except BaseException:
            response.close()
            raise
        response.release_conn()
        self.answered = True
        return Answer(response.status, response.headers, b"".join(blocks))

    def is_enduring(self) -> bool:
        """Whether a server that is away is waited for: not at first, and not when interrupted."""
        return self.answered and self.endurance is not None and not self.endurance.cancel.is_set()

    def pause(self, seconds: float, again: Resending, what: str, reason: str) -> None:
        """Wait before a request is sent again.

        Raises:
            Cancelled: the user asked to stop meanwhile.
        """
        if self.endurance is None or not again.endures:
            time.sleep(seconds)
            return
        if again.is_noticeable(seconds):
            self.endurance.begin(self.target.server, reason)
        if self.endurance.cancel.wait(seconds):
            raise Cancelled(
                f"interrupted: cannot {what}: the cluster at {self.target.server} {reason}",
                hint="run it again when the cluster answers",
            )

    def stream(
        self, path: str, what: str, *, timeout: float | None, patience: float = READ_TIMEOUT
    ) -> Stream | Answer:
        """Send a GET whose answer goes on; an answer that is an error comes as a whole.

        Args:
            timeout: seconds without a byte after which the stream counts as broken; None: never.
            patience: seconds until the answer begins.
        """
        headers = self.headers({"Accept": "application/json"})
        connection = self.connected(what)
        sock = connection.sock
        try:
            sock.settimeout(patience)
            connection.timeout = patience  # or the answer's beginning would be waited for as long
            connection.request("GET", self.url.path + path, headers=headers, preload_content=False)
            response = connection.getresponse()
            if response.status >= 400:
                answer = Answer(response.status, response.headers, response.data)
                connection.close()
                return answer
        except BROKEN as error:
            connection.close()
            raise self.unreachable_error(what, error) from error
        sock.settimeout(timeout)
        return Stream(connection, response, sock)

    def goes_on(self, path: str, seconds: float) -> bool:
        """Whether the answer to a GET has not ended some seconds after it began.

        What is no answer has not. Connecting does not count: it takes long on a busy machine.
        """
        try:
            opened = self.stream(path, "follow an answer", timeout=seconds, patience=seconds)
        except ClusterError:
            return True
        if isinstance(opened, Answer):
            return True
        timer = threading.Timer(seconds, opened.abort)
        timer.daemon = True
        timer.start()
        for _ in opened.lines():
            pass
        timer.cancel()
        return not opened.ended

    def open_socket(self, what: str) -> socket.socket:
        """Return a connected socket (with TLS) for a protocol of its own."""
        sock = self.connected(what).sock
        sock.settimeout(READ_TIMEOUT)
        return sock

    def authorization(self, *, fresh: bool = False) -> list[tuple[str, str]]:
        """Return the headers that say who we are; a credential program runs in one thread only."""
        known = self.credentials()
        with self.lock:
            return list(known.headers(fresh=fresh))

    def close(self) -> None:
        """Close what is kept open."""
        if self.kept:
            self.kept.clear()

    def headers(self, own: Mapping[str, str], *, fresh: bool = False) -> urllib3.HTTPHeaderDict:
        """Return a request's headers; those that say who we are may repeat a name."""
        whole = urllib3.HTTPHeaderDict({**own, "User-Agent": "rigel"})
        for name, value in self.authorization(fresh=fresh):
            whole.add(name, value)
        return whole

    def pool(self) -> urllib3.PoolManager:
        """Return the connections that are kept for requests."""
        options = self.options()
        with self.lock:
            if self.kept is None:
                options["timeout"] = urllib3.Timeout(connect=CONNECT_TIMEOUT, read=READ_TIMEOUT)
                options["maxsize"] = 16  # kept; more than that may be open
                self.kept = (
                    urllib3.ProxyManager(
                        self.proxy.geturl(), proxy_headers=proxy_headers(self.proxy), **options
                    )
                    if self.proxy
                    else urllib3.PoolManager(**options)
                )
            return self.kept

    def connected(self, what: str) -> HTTPConnection:
        """Return a connection that belongs to the caller."""
        kind = HTTPSConnection if self.url.scheme == "https" else HTTPConnection
        host, port = self.url.hostname or "", self.url.port or kind.default_port
        through = (self.proxy.hostname or "", self.proxy.port or 80) if self.proxy else (host, port)
        connection = kind(*through, timeout=CONNECT_TIMEOUT, **self.options())
        if self.proxy:
            connection.set_tunnel(host, port, headers=proxy_headers(self.proxy))
        try:
            connection.connect()
        except BROKEN as error:
            connection.close()
            raise self.unreachable_error(what, error) from error
        return connection

    def options(self) -> dict[str, Any]:
        """Return what each connection gets."""
        own: dict[str, Any] = {"socket_options": [*HTTPConnection.default_socket_options, *ALIVE]}
        if self.url.scheme == "https":
            own["ssl_context"] = self.context()
            own["server_hostname"] = self.target.server_name or None
        return own

    def credentials(self) -> Credentials:
        """Return who we are, found out once (a credential program may ask its user)."""
        with self.lock:
            if self.known is None:
                self.known = self.target.credentials()
            return self.known

    def context(self) -> ssl.SSLContext:
        """Return the TLS settings, made once."""
        credentials = self.credentials()
        with self.lock:
            if self.tls is None:
                self.tls = tls_context(self.target, credentials)
            return self.tls

    def unreachable_error(self, what: str, error: BaseException) -> Exception:
        """Return the error for a server that gave no answer."""
        reason = reason_of(error)
        target = self.target
        return unreachable_error(what, reason, context=target.context, server=target.server)


def tls_context(target: Target, credentials: Credentials) -> ssl.SSLContext:
    """Return the TLS settings for a target."""
    try:
        context = trust(target.authority)
        if target.insecure:
            context.check_hostname = False
            context.verify_mode = ssl.CERT_NONE
        if credentials.certificate:
            load_certificate(context, credentials)
    except (ssl.SSLError, ValueError) as error:
        raise UserError(
            f"context {target.context}: its certificates cannot be used: {error}",
            hint="mend certificate-authority, client-certificate and client-key in the kubeconfig",
        ) from error
    return context


def load_certificate(context: ssl.SSLContext, credentials: Credentials) -> None:
    """Give the client certificate to OpenSSL, which reads files only."""
    with tempfile.TemporaryDirectory(prefix="rigel-") as directory:  # 0700
        pem = Path(directory) / "client.pem"
        pem.write_text(f"{credentials.certificate.rstrip()}\n{credentials.key}")
        context.load_cert_chain(pem)


def proxy_headers(proxy: SplitResult) -> dict[str, str]:
    """Return the headers that a proxy with a user and password wants."""
    if not proxy.username:
        return {}
    pair = f"{unquote(proxy.username)}:{unquote(proxy.password or '')}"
    return dict(urllib3.make_headers(proxy_basic_auth=pair))

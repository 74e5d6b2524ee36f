"""HTTP to one API server: kept-open connections, TLS, proxies, streams, careful retries.

It knows bytes and headers, not what Kubernetes means by them. Connections are kept open and shared
by the threads; a stream (watch, logs, a websocket) takes one out for itself.
"""

from __future__ import annotations

import http.client
import os
import select
import socket
import ssl
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import suppress
from email.message import Message
from pathlib import Path
from urllib.parse import SplitResult, urlsplit

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.kube.failures import unreachable
from rigel_k8s.kube.proxy import proxy_for
from rigel_k8s.kube.target import Credentials, Target

__all__ = ["Answer", "Stream", "Transport"]

CONNECT_TIMEOUT = 10.0
READ_TIMEOUT = 75.0  # the API server itself gives up after 60 seconds
RETRIES = 5  # of what the server asks to send again
RETRY_BUDGET = 30.0  # seconds that one request may spend waiting to be sent again
BROKEN = (http.client.HTTPException, OSError)


@attrs.frozen
class Answer:
    """A whole answer."""

    status: int
    headers: Message
    body: bytes


class Stream:
    """An answer that goes on: read its lines, abort it from any thread."""

    def __init__(
        self,
        connection: http.client.HTTPConnection,
        response: http.client.HTTPResponse,
        sock: socket.socket,
    ):
        self.connection, self.response, self.socket = connection, response, sock

    def lines(self) -> Iterator[bytes]:
        """Yield lines without their end until the server or `abort` ends the stream."""
        try:
            while line := self.response.readline():
                yield line.rstrip(b"\r\n")
        except (*BROKEN, ValueError, AttributeError):
            return  # aborted, or the connection broke: the caller knows what was still to come
        finally:
            self.abort()

    def abort(self) -> None:
        """End the stream; a thread that reads it returns."""
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)
        self.connection.close()


class TLSConnection(http.client.HTTPSConnection):
    """A connection whose certificate may be for another name than the URL's."""

    def __init__(
        self, host: str, port: int, *, context: ssl.SSLContext, server_name: str, timeout: float
    ):
        super().__init__(host, port, context=context, timeout=timeout)
        self.tls, self.server_name = context, server_name

    def connect(self) -> None:
        """Connect, through the proxy where there is one, and speak TLS."""
        http.client.HTTPConnection.connect(self)
        keep_alive(self.sock)
        self.sock = self.tls.wrap_socket(self.sock, server_hostname=self.server_name)


class Transport:
    """All connections to one API server."""

    def __init__(self, target: Target):
        self.target = target
        self.url = urlsplit(target.server)
        if self.url.scheme not in ("http", "https") or not self.url.hostname:
            raise UserError(f"context {target.context}: {target.server!r} is no URL of a server")
        self.proxy = proxy_for(target.proxy, self.url, os.environ)
        self.idle: deque[http.client.HTTPConnection] = deque()
        self.lock = threading.Lock()
        self.known: Credentials | None = None
        self.tls: ssl.SSLContext | None = None

    def __del__(self) -> None:
        if hasattr(self, "lock"):  # a target that makes no sense leaves a half-made object
            self.close()

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
    ) -> Answer:
        """Send a request and return the whole answer, whatever its status is.

        Args:
            what: what is asked, for people.
            safe: whether sending it twice is harmless; None is: where the method only reads.

        Raises:
            ClusterError: there is no answer.
        """
        headers = {"Accept": accept, **({"Content-Type": media} if media else {})}
        safe = method == "GET" if safe is None else safe
        deadline, attempt, fresh = time.monotonic() + RETRY_BUDGET, 0, False
        while True:
            answer = self.once(method, path, what, body, headers, safe=safe, fresh=fresh)
            pause = retry_after(answer, attempt)
            if answer.status == 401 and not fresh:
                fresh = True
            elif pause is None or time.monotonic() + pause > deadline:
                return answer
            else:
                time.sleep(pause)
            attempt += 1

    def once(
        self,
        method: str,
        path: str,
        what: str,
        body: bytes | None,
        headers: Mapping[str, str],
        *,
        safe: bool,
        fresh: bool,
    ) -> Answer:
        """Send a request; again on a new connection where a kept one turns out to be dead."""
        for last in (False, True):
            connection, reused = self.take(new=last)
            try:
                self.send(connection, method, path, body, headers, fresh=fresh)
                response = connection.getresponse()
                answer = Answer(response.status, response.headers, response.read())
            except BROKEN as error:
                connection.close()
                if last or not (safe or (reused and method != "POST")):
                    raise self.unreachable(what, error) from error
                continue
            self.give_back(connection, response)
            return answer
        raise AssertionError("the second attempt returns or raises")

    def stream(self, path: str, what: str, *, timeout: float | None) -> Stream | Answer:
        """Send a GET whose answer goes on; an answer that is an error comes as a whole.

        Args:
            timeout: seconds without a byte after which the stream counts as broken; None: never.
        """
        connection, _ = self.take(new=True)
        try:
            self.send(connection, "GET", path, None, {"Accept": "application/json"}, fresh=False)
            sock = connection.sock
            response = connection.getresponse()
            if response.status >= 400:
                answer = Answer(response.status, response.headers, response.read())
                connection.close()
                return answer
        except BROKEN as error:
            connection.close()
            raise self.unreachable(what, error) from error
        sock.settimeout(timeout)
        return Stream(connection, response, sock)

    def goes_on(self, path: str, seconds: float) -> bool:
        """Whether the answer to a GET has not ended within some seconds; what is none has not."""
        connection, _ = self.take(new=True)
        try:
            self.send(connection, "GET", path, None, {}, fresh=False)
            deadline, sock = time.monotonic() + seconds, connection.sock
            sock.settimeout(seconds)
            response = connection.getresponse()
            while response.status < 400 and (left := deadline - time.monotonic()) > 0:
                sock.settimeout(left)
                if not response.read1():
                    return False
        except BROKEN:  # the time is over, or there is no connection
            return True
        finally:
            connection.close()
        return True

    def open_socket(self, what: str) -> socket.socket:
        """Return a connected socket (with TLS) for a protocol of its own."""
        connection, _ = self.take(new=True)
        try:
            connection.connect()
        except BROKEN as error:
            raise self.unreachable(what, error) from error
        return connection.sock

    def authorization(self, *, fresh: bool = False) -> list[tuple[str, str]]:
        """Return the headers that say who we are; a credential program runs in one thread only."""
        known = self.credentials()
        with self.lock:
            return list(known.headers(fresh=fresh))

    def close(self) -> None:
        """Close what is kept open."""
        with self.lock:
            while self.idle:
                self.idle.pop().close()

    def send(
        self,
        connection: http.client.HTTPConnection,
        method: str,
        path: str,
        body: bytes | None,
        headers: Mapping[str, str],
        *,
        fresh: bool,
    ) -> None:
        """Write one request."""
        connection.putrequest(method, self.url.path + path, skip_accept_encoding=True)
        for name, value in [*headers.items(), *self.authorization(fresh=fresh)]:
            connection.putheader(name, value)
        connection.putheader("User-Agent", "rigel")
        if body is not None:
            connection.putheader("Content-Length", str(len(body)))
        connection.endheaders(body)

    def take(self, *, new: bool) -> tuple[http.client.HTTPConnection, bool]:
        """Return a connection, and whether it was in use before."""
        with self.lock:
            while not new and self.idle:
                kept = self.idle.pop()
                if not is_closed(kept):
                    return kept, True
                kept.close()
        return self.connection(), False

    def give_back(
        self, connection: http.client.HTTPConnection, response: http.client.HTTPResponse
    ) -> None:
        """Keep a connection for the next request."""
        if response.will_close:
            connection.close()
            return
        with self.lock:
            self.idle.append(connection)

    def connection(self) -> http.client.HTTPConnection:
        """Return a new connection, not yet connected."""
        host, port = self.url.hostname or "", self.url.port or default_port(self.url)
        through = (self.proxy.hostname or "", self.proxy.port or 80) if self.proxy else (host, port)
        made: http.client.HTTPConnection
        if self.url.scheme == "http":
            made = http.client.HTTPConnection(*through, timeout=READ_TIMEOUT)
        else:
            made = TLSConnection(
                *through,
                context=self.context(),
                server_name=self.target.server_name or host,
                timeout=READ_TIMEOUT,
            )
        if self.proxy:
            made.set_tunnel(host, port, headers=proxy_headers(self.proxy))
        return made

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

    def unreachable(self, what: str, error: BaseException) -> Exception:
        """Return the error for a server that gave no answer."""
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        if isinstance(error, ssl.SSLCertVerificationError):
            reason = f"its certificate is not trusted: {error.verify_message}"
        target = self.target
        return unreachable(what, reason, context=target.context, server=target.server)


def is_closed(connection: http.client.HTTPConnection) -> bool:
    """Whether the server has closed a connection that waits: it has nothing else to say there.

    API servers close what was idle for 90 s; a POST that meets that cannot be sent again safely.
    """
    poll = select.poll()
    poll.register(connection.sock, select.POLLIN)
    return bool(poll.poll(0))


def tls_context(target: Target, credentials: Credentials) -> ssl.SSLContext:
    """Return the TLS settings for a target."""
    try:
        context = ssl.create_default_context(cadata=target.authority or None)
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


def keep_alive(sock: socket.socket) -> None:
    """Let the kernel notice a peer that is gone while a stream is silent."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    if hasattr(socket, "TCP_KEEPIDLE"):
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 30)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10)


def retry_after(answer: Answer, attempt: int) -> float | None:
    """Return the seconds after which the server wants the request again, None where it does not."""
    header = answer.headers.get("Retry-After")
    if attempt >= RETRIES or header is None or answer.status not in (429, 500, 502, 503, 504):
        return None
    return float(header) if header.isdigit() else 1.0


def default_port(url: SplitResult) -> int:
    """Return the port of a URL that names none."""
    return 443 if url.scheme == "https" else 80


def proxy_headers(proxy: SplitResult) -> dict[str, str]:
    """Return the headers that a proxy with a user and password wants."""
    if not proxy.username:
        return {}
    import base64
    from urllib.parse import unquote

    pair = f"{unquote(proxy.username)}:{unquote(proxy.password or '')}".encode()
    return {"Proxy-Authorization": f"Basic {base64.b64encode(pair).decode()}"}

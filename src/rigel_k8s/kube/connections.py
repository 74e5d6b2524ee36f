"""Connections to one API server: their destination, trust and credentials.

Threads share the pool for requests; a stream or a websocket gets a connection of its own.
"""

from __future__ import annotations

import http.client
import os
import socket
import ssl
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import SplitResult, unquote, urlsplit

import urllib3
from urllib3.connection import HTTPConnection, HTTPSConnection
from urllib3.exceptions import (
    ConnectTimeoutError,
    HTTPError,
    InsecureRequestWarning,
    NewConnectionError,
    ProxyError,
)

from rigel_k8s.errors import UserError
from rigel_k8s.kube.target import Credentials, Target
from rigel_k8s.system.tls import proxy_for, trust

CONNECT_TIMEOUT = 10.0
READ_TIMEOUT = 75.0  # the API server itself gives up after 60 seconds
# The kernel notices a lost peer while a stream is silent.
ALIVE: list[tuple[int, int, int]] = [(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)]
if hasattr(socket, "TCP_KEEPIDLE"):
    ALIVE += [
        (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 30),
        (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 10),
    ]


class Connections:
    """The pool of connections to one API server, and what all other connections are made with."""

    def __init__(self, target: Target):
        self.target = target
        self.url = urlsplit(target.server)
        if self.url.scheme not in ("http", "https") or not self.url.hostname:
            raise UserError(
                f"context {target.context}: {target.server!r} is not the URL of a server"
            )
        self.proxy = proxy_for(target.proxy, self.url, os.environ)
        self.lock = threading.Lock()
        self.known: Credentials | None = None
        self.tls: ssl.SSLContext | None = None
        self.kept: urllib3.PoolManager | None = None
        if target.insecure:
            urllib3.disable_warnings(InsecureRequestWarning)  # the kubeconfig requests it

    def authorization(self, *, fresh: bool = False) -> list[tuple[str, str]]:
        """Return the headers with our credentials; a credential program runs in one thread only."""
        known = self.credentials()
        with self.lock:
            return list(known.headers(fresh=fresh))

    def close(self) -> None:
        """Close all open connections."""
        if self.kept:
            self.kept.clear()

    def pool(self) -> urllib3.PoolManager:
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

    def connect(self) -> HTTPConnection:
        """Return a connection of the caller's own; raises one of BROKEN."""
        kind = HTTPSConnection if self.url.scheme == "https" else HTTPConnection
        host, port = self.url.hostname or "", self.url.port or kind.default_port
        through = (self.proxy.hostname or "", self.proxy.port or 80) if self.proxy else (host, port)
        connection = kind(*through, timeout=CONNECT_TIMEOUT, **self.options())
        if self.proxy:
            connection.set_tunnel(host, port, headers=proxy_headers(self.proxy))
        try:
            connection.connect()
        except BROKEN:
            connection.close()
            raise
        return connection

    def options(self) -> dict[str, Any]:
        """Return the options of every connection."""
        own: dict[str, Any] = {"socket_options": [*HTTPConnection.default_socket_options, *ALIVE]}
        if self.url.scheme == "https":
            own["ssl_context"] = self.context()
            own["server_hostname"] = self.target.server_name or None
        return own

    def credentials(self) -> Credentials:
        """Return our credentials, read once (a credential program may ask its user)."""
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
            hint="correct certificate-authority, client-certificate and client-key in the"
            " kubeconfig",
        ) from error
    return context


def load_certificate(context: ssl.SSLContext, credentials: Credentials) -> None:
    """Give the client certificate to OpenSSL, which reads files only."""
    with tempfile.TemporaryDirectory(prefix="rigel-") as directory:  # 0700
        pem = Path(directory) / "client.pem"
        pem.write_text(f"{credentials.certificate.rstrip()}\n{credentials.key}")
        context.load_cert_chain(pem)


def proxy_headers(proxy: SplitResult) -> dict[str, str]:
    """Return the headers for a proxy with a user and password."""
    if not proxy.username:
        return {}
    pair = f"{unquote(proxy.username)}:{unquote(proxy.password or '')}"
    return dict(urllib3.make_headers(proxy_basic_auth=pair))


BLOCK = 32 * 1024


class Stream:
    """An endless answer: read its lines, abort it from any thread.

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
            return  # aborted, or the connection broke: the caller decides what was still to come
        finally:
            self.abort()

    def abort(self) -> None:
        """End the stream; a thread that reads it returns."""
        self.aborted = True
        with suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)
        with suppress(OSError, ValueError, AttributeError):  # a reader may close it at this moment
            self.connection.close()


#: The errors of an exchange that ends without an answer.
BROKEN = (HTTPError, http.client.HTTPException, OSError)


def is_sent(error: BaseException) -> bool:
    """Whether the server may have received a request that broke: the connection existed before."""
    return not isinstance(error, (NewConnectionError, ConnectTimeoutError, ProxyError))


def is_untrusted(error: BaseException) -> bool:
    """Whether a server showed a certificate that is not trusted: it will show the same again."""
    return isinstance(cause_of(error), ssl.SSLCertVerificationError)


def reason_of(error: BaseException) -> str:
    """Return why no answer came, in the words of the innermost error."""
    cause = cause_of(error)
    if isinstance(cause, ssl.SSLCertVerificationError):
        return f"its certificate is not trusted: {cause.verify_message}"
    return getattr(cause, "strerror", None) or str(cause) or type(cause).__name__


def cause_of(error: BaseException) -> BaseException:
    """Return the innermost error: urllib3 wraps it in text about its own pools and retries."""
    inner = (getattr(error, "reason", None), *reversed(error.args), error.__cause__)
    found = next((one for one in inner if isinstance(one, BaseException)), None)
    return error if found is None else cause_of(found)

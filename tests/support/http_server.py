"""A small HTTP server that records what it is asked and answers what the test says."""

from __future__ import annotations

import json
import socket
import ssl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from email.message import Message
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread
from typing import Any
from urllib.parse import parse_qs, urlsplit

import attrs

POLL = 0.01  # seconds: what ending a server costs a test


@attrs.frozen
class Request:
    """One request as it came.

    Attributes:
        path: without the query.
        connection: the number of its connection, from 1.
    """

    method: str
    path: str
    query: dict[str, list[str]]
    headers: Message
    body: bytes
    connection: int

    @property
    def json(self) -> Any:
        return json.loads(self.body)

    def __str__(self) -> str:
        return f"{self.method} {self.path}"


class Exchange(BaseHTTPRequestHandler):
    """One connection; the test's function answers its requests with these methods."""

    protocol_version = "HTTP/1.1"
    server: HttpServer
    request_: Request

    def say(self, status: int, body: object = b"", **headers: str) -> None:
        """Answer as a whole; what is not bytes is sent as JSON."""
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        for name, value in {"Content-Length": str(len(data)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        self.wfile.write(data)

    def stream(self, *chunks: object) -> None:
        """Begin an answer that goes on, with chunks of bytes or lines of JSON."""
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        for chunk in chunks:
            self.chunk(chunk)

    def chunk(self, chunk: object) -> None:
        """Send one more chunk of a stream; b"" ends it."""
        data = chunk if isinstance(chunk, bytes) else json.dumps(chunk).encode() + b"\n"
        self.wfile.write(b"%x\r\n%s\r\n" % (len(data), data))

    def hang_up(self) -> None:
        """Close the connection after this request, without having said so."""
        self.close_connection = True

    def tunnel(self, port: int) -> None:
        """Answer a CONNECT and carry bytes to a port of this machine and back."""
        self.send_response(200)
        self.end_headers()
        self.hang_up()
        with socket.create_connection(("127.0.0.1", port)) as far:
            Thread(target=carry, args=(far, self.connection), daemon=True).start()
            carry(self.connection, far)

    def setup(self) -> None:
        super().setup()
        with self.server.lock:
            self.server.connections += 1
            self.number = self.server.connections

    def do_GET(self) -> None:
        parts = urlsplit(self.path if self.command != "CONNECT" else f"//{self.path}")
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        query = parse_qs(parts.query, keep_blank_values=True)
        path = parts.path or parts.netloc  # a proxy is asked for a host
        self.request_ = Request(self.command, path, query, self.headers, body, self.number)
        self.server.requests.append(self.request_)
        self.server.answer(self)

    do_POST = do_PUT = do_PATCH = do_DELETE = do_HEAD = do_CONNECT = do_GET

    def log_message(self, *_: object) -> None:
        """Say nothing."""


def carry(source: socket.socket, sink: socket.socket) -> None:
    with suppress(OSError):
        while data := source.recv(65536):
            sink.sendall(data)
        sink.shutdown(socket.SHUT_RDWR)


class HttpServer(ThreadingHTTPServer):
    """A server on a port of this machine; 0 is a free one.

    Attributes:
        answer: is called with the exchange for each request; a test may replace it.
        requests: what came, in order.
        connections: how many were opened.
        closed: is released for each connection that the server has closed.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(
        self,
        answer: Callable[[Exchange], None],
        *,
        tls: ssl.SSLContext | None = None,
        port: int = 0,
    ):
        super().__init__(("127.0.0.1", port), Exchange)
        self.answer, self.tls = answer, tls
        self.requests: list[Request] = []
        self.connections = 0
        self.closed = threading.Semaphore(0)
        self.lock = threading.Lock()

    @property
    def url(self) -> str:
        return f"{'https' if self.tls else 'http'}://127.0.0.1:{self.server_port}"

    def list_requests(self) -> list[str]:
        """Return the requests as `GET /path`."""
        return [str(request) for request in self.requests]

    def finish_request(self, request: Any, client_address: Any) -> None:
        if self.tls:
            request = self.tls.wrap_socket(request, server_side=True)
        try:
            super().finish_request(request, client_address)
        finally:
            if self.tls:
                request.close()

    def shutdown_request(self, request: Any) -> None:
        super().shutdown_request(request)
        self.closed.release()

    def handle_error(self, *_: object) -> None:
        """A client that leaves in the middle is what some tests are about."""


@contextmanager
def serving(
    answer: Callable[[Exchange], None], *, tls: ssl.SSLContext | None = None, port: int = 0
) -> Iterator[HttpServer]:
    """Serve until the context ends."""
    server = HttpServer(answer, tls=tls, port=port)
    Thread(target=server.serve_forever, args=(POLL,), daemon=True).start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()

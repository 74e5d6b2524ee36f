"""A proxy between `rigel` (plain HTTP) and an API server (TLS) that injects faults."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import urllib3
from urllib3.exceptions import HTTPError, InsecureRequestWarning

from bench.chaos.faults import GARBAGE, ODD_EVENTS, Fault, Weather, refusal

BLOCK = 64 * 1024
SILENCE = 20.0  # seconds after which a silent connection ends
HEADERS = ("Authorization", "Accept", "Content-Type", "User-Agent")
LINGER = struct.pack("ii", 1, 0)
PAGE = b"<html><body><h1>503 Service Unavailable</h1></body></html>"


class FaultProxy(ThreadingHTTPServer):
    """Forwards to one API server.

    Attributes:
        weather: the faults of the command that runs; None: there are none.
        injected: how often each fault was injected so far.
        met: the request at which the outage began, "" without an outage.
    """

    daemon_threads = True
    block_on_close = False
    request_queue_size = 64

    def __init__(self, upstream: str):
        super().__init__(("127.0.0.1", 0), Exchange)
        urllib3.disable_warnings(InsecureRequestWarning)
        self.upstream = upstream
        self.pool = urllib3.PoolManager(maxsize=32, cert_reqs="CERT_NONE", timeout=90)
        self.injected: Counter[str] = Counter()
        self.lock = threading.Lock()
        self.weather: Weather | None = None
        self.begin(None)

    @property
    def url(self) -> str:
        """Where it listens."""
        return f"http://127.0.0.1:{self.server_port}"

    def begin(self, weather: Weather | None) -> None:
        """Begin a command."""
        with self.lock:
            self.weather = weather
            self.seen: Counter[tuple[str, str]] = Counter()
            self.number = 0
            self.away_until = 0.0
            self.met = ""

    def next_fault(self, method: str, path: str, *, stream: bool) -> Fault | None:
        """Return the fault of the next request."""
        with self.lock:
            weather, number = self.weather, self.number
            if weather is None:
                return None
            time_, self.number = self.seen[method, path], number + 1
            self.seen[method, path] += 1
            if weather.is_away(number) and not self.away_until:
                self.away_until = time.monotonic() + weather.seconds
                self.met = f"{method} {path}"
            fault = weather.fault(method, path, time_, stream=stream)
            if time.monotonic() < self.away_until and weather.outage:
                fault = Fault(weather.outage, False)
            if fault:
                self.injected[fault.word] += 1
            return fault

    def is_cut(self) -> bool:
        """Whether open streams end, since an outage has begun."""
        return time.monotonic() < self.away_until

    def handle_error(self, *_: object) -> None:
        """Ignore clients that end a connection early."""


class Exchange(BaseHTTPRequestHandler):
    """One connection of a client."""

    protocol_version = "HTTP/1.1"
    server: FaultProxy
    wbufsize = -1  # a whole answer in one packet

    def do_GET(self) -> None:
        """Answer a request, or inject its fault."""
        parts = urlsplit(self.path)
        stream = "watch" in parse_qs(parts.query)
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        fault = self.server.next_fault(self.command, self.path, stream=stream)
        if fault and not fault.forwarded:
            self.fail(fault)
            return
        try:
            response = self.forward(body)
        except HTTPError:
            self.break_off()
            return
        if stream and response.status < 400:
            self.pass_stream(response, fault)
        else:
            self.pass_whole(response.status, response.data, fault)

    do_POST = do_PUT = do_PATCH = do_DELETE = do_GET

    def forward(self, body: bytes) -> Any:
        """Send the request to the API server."""
        own = {name: self.headers[name] for name in HEADERS if self.headers[name]}
        return self.server.pool.request(
            self.command,
            self.server.upstream + self.path,
            body=body or None,
            headers=own,
            preload_content=False,
            retries=False,
            redirect=False,
        )

    def fail(self, fault: Fault) -> None:
        """Answer without the API server."""
        word = fault.word
        if word == "reset":
            self.break_off(reset=True)
        elif word == "hang-up":
            self.break_off()
        elif word == "silent":
            self.keep_silent()
        elif word in GARBAGE:
            self.say(200, GARBAGE[word])
        elif word == "503 page":
            self.say(503, PAGE, fault.retry_after)
        else:
            self.say(int(word), refusal(int(word)), fault.retry_after)

    def pass_whole(self, status: int, body: bytes, fault: Fault | None) -> None:
        """Pass an answer on, complete or damaged."""
        word = fault.word if fault else ""
        if word == "lost":
            self.break_off(reset=True)
        elif word == "cut":
            self.begin(status, len(body))
            self.wfile.write(body[: len(body) // 2])
            self.break_off()
        elif word == "slow":
            self.begin(status, len(body))
            for i in range(8):
                self.wfile.write(body[len(body) * i // 8 : len(body) * (i + 1) // 8])
                self.wfile.flush()
                time.sleep(0.1)
        elif word.startswith("late") and fault:
            code = int(word.removeprefix("late "))
            self.say(code, refusal(code), fault.retry_after)
        elif word == "truncated":
            self.say(status, body[: len(body) // 2])
        elif word in GARBAGE:
            self.say(200, GARBAGE[word])
        else:
            self.say(status, body)

    def pass_stream(self, response: Any, fault: Fault | None) -> None:
        """Pass a watch on until it ends or is ended."""
        self.send_response(200)
        self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        self.wfile.flush()
        number = 0
        with suppress(HTTPError, OSError):
            while block := response.read1(BLOCK):
                if self.server.is_cut():
                    break
                if fault and number == fault.events and self.spoil(fault.word):
                    break
                self.chunk(block)
                number += 1
        response.close()
        self.close_connection = True

    def spoil(self, word: str) -> bool:
        """Inject a fault into a stream; return whether it ends."""
        if word in ODD_EVENTS:
            self.chunk(ODD_EVENTS[word])
        if word == "silent stream":
            time.sleep(1)
        if word == "end":
            self.chunk(b"")
        return word not in ("null event", "odd event")

    def say(self, status: int, body: bytes, retry_after: str = "") -> None:
        """Send a complete answer."""
        self.begin(status, len(body), retry_after)
        self.wfile.write(body)
        self.wfile.flush()

    def begin(self, status: int, length: int, retry_after: str = "") -> None:
        """Send the head of an answer."""
        self.send_response_only(status)
        self.send_header("Content-Type", "application/json")
        self.send_header("Content-Length", str(length))
        if retry_after:
            self.send_header("Retry-After", retry_after)
        self.end_headers()

    def chunk(self, block: bytes) -> None:
        """Send one block of a stream; an empty one ends it."""
        self.wfile.write(b"%x\r\n%s\r\n" % (len(block), block))
        self.wfile.flush()

    def keep_silent(self) -> None:
        """Answer nothing until the client closes the connection."""
        with suppress(OSError):
            self.connection.settimeout(SILENCE)
            self.connection.recv(1)
        self.close_connection = True

    def break_off(self, *, reset: bool = False) -> None:
        """End the connection, with a reset or regularly."""
        with suppress(OSError):
            self.wfile.flush()
            if reset:
                self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, LINGER)
            else:
                self.connection.shutdown(socket.SHUT_RDWR)
        self.close_connection = True
        if reset:
            self.connection.close()

    def log_message(self, *_: object) -> None:
        """Log nothing."""


@contextmanager
def fault_proxy(upstream: str) -> Iterator[FaultProxy]:
    """Serve until the context ends."""
    proxy = FaultProxy(upstream)
    threading.Thread(target=proxy.serve_forever, args=(0.05,), daemon=True).start()
    try:
        yield proxy
    finally:
        proxy.shutdown()
        proxy.server_close()

"""The server of the page: which requests it answers, and which browser may send them.

It serves one user of this machine, who has the token. It checks four things. Each of them is
enough against a page of another site in the same browser; the first one also keeps out other users
of the machine:

- the token, the first part of every path, compared in constant time;
- the name in `Host`, which must be one of the loopback's (so DNS rebinding does not work);
- the `Origin` of every request that has one or that writes, which must be the page's own;
- the Content-Security-Policy, which lets the page load and run only its own files.

Without `changes` there is no path that writes. Each request has a thread and a connection of its
own; a browser that neither sends nor reads loses it after some seconds. Nothing is logged.
"""

from __future__ import annotations

import hmac
import json
import mimetypes
import secrets
import select
import socket
import sys
import threading
import time
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingTCPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

import attrs

from rigel_ui.feed import Changes, Feed
from rigel_ui.logs import LogHub
from rigel_ui.readings import Readings

ADDRESS = "127.0.0.1"
FILES = Path(__file__).parent / "page"
#: The names by which a browser of this machine reaches it.
HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
#: A page has its own scripts (one of them Graphviz as WebAssembly), styles and pictures, and
#: connections to its own server.
POLICY = (
    "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; img-src 'self';"
    " connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none';"
    " require-trusted-types-for 'script'; trusted-types 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
LONGEST = 1024  # bytes of a request's body
LARGEST = 10**9  # of a revision's number
PATIENCE = 10.0  # seconds in which a browser must have sent its request, or read what it gets
LOOK = 1.0  # seconds after which a page without news is looked at: it may have gone
TICKET = 60.0  # seconds in which the browser that we open must come
REFRESH = 5  # seconds after which a page in the background gets everything again
DENIED = "Open the address that `rigel ui` has printed: it contains a token.\n"
TEXT, JSON = "text/plain; charset=utf-8", "application/json"


class Tickets:
    """Addresses that lead to the page once, since other users can read a browser's command line."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._known: dict[str, float] = {}

    def issue(self) -> str:
        """Return a new ticket."""
        made = secrets.token_urlsafe(24)
        with self._lock:
            self._known[made] = time.monotonic() + TICKET
        return made

    def take(self, ticket: str) -> bool:
        """Return whether a ticket is valid; each is valid only once."""
        with self._lock:
            match = [known for known in self._known if same(known, ticket)]
            return any(self._known.pop(known) > time.monotonic() for known in match)


def same(one: str, other: str) -> bool:
    """Whether two secrets are the same, in a time that does not depend on where they differ."""
    return hmac.compare_digest(one.encode(), other.encode())


@attrs.frozen
class Answer:
    """An answer with its body."""

    status: int
    body: bytes
    kind: str = TEXT
    headers: Mapping[str, str] = {}


def say(status: int, text: str) -> Answer:
    """Return an answer that is a line for a person."""
    return Answer(status, f"{text}\n".encode())


def lead_to(path: str) -> Answer:
    """Return an answer that leads a browser elsewhere on this server."""
    return Answer(303, b"", headers={"Location": path})


class PageServer(ThreadingTCPServer):
    """Serves one release's page at the loopback.

    Args:
        port: 0 is any that is free.
        changes: carries out what a page asks for; None: no such path exists.
        readings: reads what a page asks for; each kind has a path.

    Raises:
        OSError: the port is taken.
    """

    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False
    request_queue_size = 128

    def __init__(
        self,
        port: int,
        feed: Feed,
        logs: LogHub,
        token: str,
        changes: Changes | None,
        readings: Readings,
    ) -> None:
        super().__init__((ADDRESS, port), Handler)
        self.feed, self.logs, self.token, self.changes = feed, logs, token, changes
        self.readings = readings
        self.tickets = Tickets()
        #: The page's files by name; the server has no others.
        self.texts = {
            path.relative_to(FILES).as_posix(): path.read_bytes()
            for path in FILES.rglob("*")
            if path.is_file()
        }
        self.over = threading.Event()

    @property
    def port(self) -> int:
        """The port at which it listens."""
        return int(self.server_address[1])

    def close(self) -> None:
        """End the server and its pages."""
        self.over.set()
        self.shutdown()
        self.server_close()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print an error of ours; a browser that has gone is none."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


class Handler(BaseHTTPRequestHandler):
    """Answers one request."""

    server: PageServer
    timeout = PATIENCE

    def do_GET(self) -> None:
        """Answer a request that reads."""
        refused = self._refuse()
        if refused:
            return self._send(refused)
        parts = urlsplit(self.path)
        name = parts.path.removeprefix(f"/{self.server.token}/")
        if name == "live" and self.command == "GET":
            return self._stream(parse_qs(parts.query))
        names = parse_qs(parts.query).get("name")
        if name in self.server.readings.kinds and names and self.command == "GET":
            read = self.server.readings.read(name, names[0])
            return self._send(Answer(200, json.dumps(read).encode(), JSON))
        body = self.server.texts.get(name or "index.html")
        if body is None:
            return self._send(say(404, "There is no such file."))
        kind = mimetypes.guess_type(name or "index.html")[0] or "application/octet-stream"
        self._send(Answer(200, body, f"{kind}; charset=utf-8" if "text" in kind else kind))

    do_HEAD = do_GET

    def do_POST(self) -> None:
        """Answer a request that writes."""
        changes = self.server.changes
        refused = self._refuse()
        if refused:
            return self._send(refused)
        if changes is None or urlsplit(self.path).path != f"/{self.server.token}/rollback":
            return self._send(say(405, "Nothing can be written here."))
        number = self._read_number()
        if number is None:
            self._reply(400, 'the body must be {"revision": NUMBER}')
        elif not changes.start(number):
            self._reply(409, "another rollback is still running")
        else:
            self._reply(202, "")

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer a request that is not HTTP, or of a method that no path has."""
        self._send(say(405 if code == 501 else code, "This request is not valid here."))

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: a log would contain the token."""

    def _refuse(self) -> Answer | None:
        """Return the answer to a request that may not pass, None for one that may."""
        hosts = self.headers.get_all("Host", [])
        if len(hosts) != 1 or find_name(hosts[0]) not in HOSTS:
            return say(421, "This server answers to 127.0.0.1 only.")
        plain = self.command in ("GET", "HEAD")
        own = f"http://{hosts[0]}"
        if self.headers.get("Origin", own if plain else "") != own:
            return say(403, "A page of another site may not ask this.")
        first, slash, rest = urlsplit(self.path).path.removeprefix("/").partition("/")
        if plain and first == "open" and self.server.tickets.take(rest):
            return lead_to(f"/{self.server.token}/")
        if not same(first, self.server.token):
            return Answer(403, DENIED.encode())
        return None if slash else lead_to(f"/{first}/")

    def _reply(self, status: int, message: str) -> None:
        self._send(Answer(status, json.dumps({"message": message}).encode(), JSON))

    def _send(self, answer: Answer) -> None:
        headers = {"Content-Type": answer.kind, "Content-Length": str(len(answer.body))}
        self._begin(answer.status, {**headers, **answer.headers})
        if self.command != "HEAD":
            self.wfile.write(answer.body)

    def _begin(self, status: int, headers: Mapping[str, str]) -> None:
        self.close_connection = True
        self.send_response_only(status)
        for name, value in {**headers, "Connection": "close", **HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()

    def _read_number(self) -> int | None:
        """Return the revision that a request names, None if its body is invalid."""
        length = self.headers.get("Content-Length", "")
        if self.headers.get("Content-Type") != JSON or not length.isdecimal():
            return None
        if len(length) > 4 or int(length) > LONGEST:
            return None
        try:
            data = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            return None
        number = data.get("revision") if isinstance(data, dict) else None
        if not isinstance(number, int) or isinstance(number, bool):
            return None
        return number if 0 < number < LARGEST else None

    def _stream(self, words: Mapping[str, list[str]]) -> None:
        """Send a page everything and then changes, as server-sent events, until it is closed.

        Args:
            words: `follow`, the node whose log it gets; `behind`, if it is in the background: it
                gets everything once, and comes back.
        """
        self._begin(200, {"Content-Type": "text/event-stream"})
        if "behind" in words:
            self._write(self.server.feed.write_all(), f"retry: {REFRESH * 1000}\n")
            return
        page = self.server.feed.subscribe()
        try:
            for node in words.get("follow", [])[:1]:
                self.server.logs.follow(node, page)
            while not self.server.over.is_set():
                text = page.next(LOOK)
                if text is not None:
                    self._write(text, "retry: 1000\n")
                elif self._has_gone():
                    return
        finally:
            self.server.feed.unsubscribe(page)
            self.server.logs.leave(page)

    def _write(self, text: str, words: str) -> None:
        self.wfile.write(f"{words}data: {text}\n\n".encode())

    def _has_gone(self) -> bool:
        """Whether the page has closed its connection; it sends nothing more after its request."""
        if not select.select([self.connection], [], [], 0)[0]:
            return False
        rest: bytes = self.connection.recv(1, socket.MSG_PEEK)
        return not rest


def find_name(host: str) -> str:
    """Return the name in a `Host`, "" if it is invalid; the port may be that of a tunnel."""
    try:
        parts = urlsplit(f"//{host}")
        _ = parts.port  # raises ValueError if it is not a number
    except ValueError:
        return ""
    if parts.username is not None or parts.path or parts.query or parts.fragment:
        return ""
    name = parts.hostname or ""
    return f"[{name}]" if ":" in name else name

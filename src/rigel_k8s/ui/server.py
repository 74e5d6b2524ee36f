"""The web application: which requests it answers, and which browser may send them.

It serves one user of this machine, who has the token. It checks four things. Each of them is
enough against a page of another site in the same browser; the first one also keeps out other users
of the machine:

- the token, the first part of every path, compared in constant time;
- the name in `Host`, which must be one of the loopback's (so DNS rebinding does not work);
- the `Origin` of every request except a plain GET, which must be the page's own;
- the Content-Security-Policy, which lets the page load and run only its own files.

Without `changes` there is no path that writes.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import mimetypes
import secrets
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from rigel_k8s.ui.changes import Changes
from rigel_k8s.ui.feed import Feed, Page
from rigel_k8s.ui.logs import LogHub

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

FILES = Path(__file__).parent / "page"
#: What draws graphs; it comes from npm (tools/npm.py).
LIBRARY = FILES / "lib" / "dagre.js"
#: The names by which a browser of this machine reaches it.
HOSTS = frozenset({"127.0.0.1", "localhost", "[::1]"})
#: A page has its own scripts, styles and pictures, and a connection to its own server.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self';"
    " base-uri 'none'; form-action 'none'; frame-ancestors 'none';"
    " require-trusted-types-for 'script'; trusted-types 'none'"
)
HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
LONGEST = 1024  # bytes of a request's body, and of a message of a page
TICKET = 60.0  # seconds in which the browser that we open must come
DENIED = "Open the address that `rigel ui` has printed: it contains a token.\n"


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


class Guard:
    """Lets through only what the user's own page asks; all answers get the headers."""

    def __init__(self, app: ASGIApp, token: str, tickets: Tickets) -> None:
        self._app, self._token, self._tickets = app, token, tickets

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return

        async def send_guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message["headers"], *HEADERS]}
            await send(message)

        refused = self._refuse(scope)
        if refused is None:
            _, _, rest = scope["path"].lstrip("/").partition("/")
            inner = {**scope, "path": f"/{rest}", "raw_path": f"/{rest}".encode()}
            await self._app(inner, receive, send_guarded)
        elif scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
        else:
            await refused(scope, receive, send_guarded)

    def _refuse(self, scope: Scope) -> Response | None:
        """Return the answer to a request that may not pass, None for one that may."""
        headers = {
            name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]
        }
        host = headers.get("host", "")
        if find_name(host) not in HOSTS:
            return PlainTextResponse("This server answers to 127.0.0.1 only.\n", 421)
        plain = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not plain and headers.get("origin") != f"http://{host}":
            return PlainTextResponse("A page of another site may not ask this.\n", 403)
        first, _, rest = scope["path"].lstrip("/").partition("/")
        if plain and first == "open" and self._tickets.take(rest):
            return RedirectResponse(f"/{self._token}/", 303)
        if not same(first, self._token):
            return PlainTextResponse(DENIED, 403)
        if not scope["path"].startswith(f"/{first}/"):
            return RedirectResponse(f"/{first}/", 303)
        return None


def same(one: str, other: str) -> bool:
    """Whether two secrets are the same, in a time that does not depend on where they differ."""
    return hmac.compare_digest(one.encode(), other.encode())


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


def make_app(
    feed: Feed, logs: LogHub, token: str, tickets: Tickets, changes: Changes | None
) -> ASGIApp:
    """Return the application.

    Args:
        changes: carries out what a page asks for; None: no such path exists.
    """
    texts = read_files()

    async def show(request: Request) -> Response:
        name = request.path_params.get("name") or "index.html"
        if name not in texts:
            return PlainTextResponse("There is no such file.\n", 404)
        kind = mimetypes.guess_type(name)[0] or "application/octet-stream"
        return Response(texts[name], media_type=kind)

    async def live(socket: WebSocket) -> None:
        await serve_page(socket, feed, logs)

    routes = [Route("/", show), WebSocketRoute("/live", live), Route("/{name:path}", show)]
    if changes is not None:
        routes.insert(0, Route("/rollback", make_rollback(changes), methods=["POST"]))
    return Guard(Starlette(routes=routes), token, tickets)


def make_rollback(changes: Changes) -> Any:
    """Return what answers the request for a rollback."""

    async def roll_back(request: Request) -> Response:
        number = await read_number(request)
        if number is None:
            return JSONResponse({"message": 'the body must be {"revision": NUMBER}'}, 400)
        if not changes.start(number):
            return JSONResponse({"message": "another rollback is still running"}, 409)
        return JSONResponse({}, 202)

    return roll_back


async def read_number(request: Request) -> int | None:
    """Return the revision that a request names, None if its body is invalid."""
    if request.headers.get("content-type") != "application/json":
        return None
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > LONGEST:
            return None
    try:
        data = json.loads(body)
    except ValueError:
        return None
    number = data.get("revision") if isinstance(data, dict) else None
    right = isinstance(number, int) and not isinstance(number, bool) and number > 0
    return number if right else None


async def serve_page(socket: WebSocket, feed: Feed, logs: LogHub) -> None:
    """Send a page what changes until it is closed; the page sends which node's log it shows."""
    await socket.accept()
    page = Page(asyncio.get_running_loop(), feed.write_all)
    feed.subscribe(page)
    writer = asyncio.create_task(write(socket, page))
    try:
        while True:
            follow(await socket.receive_text(), page, logs)
    except WebSocketDisconnect:
        pass
    except (ValueError, KeyError):  # KeyError: Starlette's, for bytes instead of a text
        await socket.close(1008)
    finally:
        page.close()
        await writer
        feed.unsubscribe(page)
        logs.leave(page)


async def write(socket: WebSocket, page: Page) -> None:
    """Send a page its texts until it is closed."""
    while (text := await page.next()) is not None:
        try:
            await socket.send_text(text)
        except (WebSocketDisconnect, RuntimeError):  # it was closed from the other side
            return


def follow(text: str, page: Page, logs: LogHub) -> None:
    """Follow the log that a page requests by `{"follow": NODE}`; null for none.

    Raises:
        ValueError: the message is not of that form.
    """
    said = json.loads(text) if len(text) <= LONGEST else None
    if not isinstance(said, dict) or said.keys() != {"follow"}:
        raise ValueError('the message must be {"follow": NODE}')
    logs.leave(page)
    if isinstance(said["follow"], str) and said["follow"]:
        logs.follow(said["follow"], page)


def read_files() -> Mapping[str, bytes]:
    """Return the page's files by name; the server has no others."""
    return {
        path.relative_to(FILES).as_posix(): path.read_bytes()
        for path in FILES.rglob("*")
        if path.is_file()
    }

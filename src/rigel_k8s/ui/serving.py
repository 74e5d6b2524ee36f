"""Runs the server of a page on the loopback until Ctrl-C or SIGTERM."""

from __future__ import annotations

import os
import secrets
import socket
import threading
import time
import webbrowser
from collections.abc import Callable
from typing import Any

import attrs

from rigel_k8s.commands import releases
from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.kube import connect
from rigel_k8s.release.types import Revision
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings
from rigel_k8s.ui.changes import Changes, Rollback
from rigel_k8s.ui.feed import Feed
from rigel_k8s.ui.live import Live
from rigel_k8s.ui.logs import LogHub, read_log

ADDRESS = "127.0.0.1"
GRACE = 2  # seconds that open connections have at the end
INSTALL = "pip install 'rigel-k8s[ui]'"


@attrs.frozen
class UiOptions:
    """How a page is served.

    Attributes:
        port: of the loopback; 0 is any that is free.
        browser: open it.
        allow_changes: a page may roll back.
    """

    port: int = 0
    browser: bool = True
    allow_changes: bool = False


def serve(
    settings: Settings, job: str | None, options: UiOptions, report: Callable[[str], None]
) -> None:
    """Serve the page of a release until Ctrl-C or SIGTERM.

    Args:
        report: takes lines for the terminal; the first one has the address.

    Raises:
        UserError: a part of the extra `ui` is missing, or the port is taken.
    """
    server_type = require_extra()
    found = release(settings, job)
    feed = Feed()
    logs = LogHub(read_log(found))
    changes = None
    if options.allow_changes:
        changes = Changes(feed, make_rollback(found, settings))
    feed.publish("server", {"server": {"changes": options.allow_changes}})
    live = Live(found, feed, report)
    with found.cluster, bind(options.port) as listening, interruptible() as cancel:
        token, port = secrets.token_urlsafe(24), listening.getsockname()[1]
        server, tickets = server_type(feed, logs, token, changes)
        thread = threading.Thread(target=server.run, args=([listening],), daemon=True)
        thread.start()
        report(f"http://{ADDRESS}:{port}/{token}/")
        live.start()
        if options.browser and has_display():
            open_browser(f"http://{ADDRESS}:{port}/open/{tickets.issue()}", report)
        try:
            while not cancel.wait(1.0) and thread.is_alive():
                pass
            if not cancel.is_set():
                raise RigelK8sError("the server of the page has ended: see the lines above")
        finally:
            live.close()
            logs.close()
            if changes is not None and changes.running:
                report("interrupting the rollback")
                changes.close()
            server.should_exit = True
            thread.join(GRACE + 1)


def make_rollback(found: Release, settings: Settings) -> Rollback:
    """Return what rolls a release back, by a connection of its own."""

    def call(number: int, report: Reporter, cancel: threading.Event) -> Revision:
        own = attrs.evolve(found, cluster=connect(settings))
        return releases.roll_back(own, settings, number, report, cancel)

    return call


def require_extra() -> Callable[..., Any]:
    """Return what makes a server.

    Raises:
        UserError: a part of the extra is not installed.
    """
    try:
        import uvicorn
        import websockets  # noqa: F401 - uvicorn imports it at the first page

        from rigel_k8s.ui.server import LIBRARY, Tickets, make_app
    except ImportError as error:
        raise UserError(
            f"`rigel ui` needs {error.name or 'packages'}, which is not installed", hint=INSTALL
        ) from error
    if not LIBRARY.is_file():
        raise UserError(
            "this installation of rigel-k8s was built without the library that draws graphs",
            hint="in a checkout: `python tools/npm.py`; else install a released wheel",
        )

    def make(feed: Feed, logs: LogHub, token: str, changes: Changes | None) -> tuple[Any, Any]:
        tickets = Tickets()
        config = uvicorn.Config(
            make_app(feed, logs, token, tickets, changes),
            access_log=False,  # it would have the token
            log_level="error",
            server_header=False,
            date_header=False,
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=4096,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=GRACE,
        )
        return uvicorn.Server(config), tickets

    return make


def bind(port: int) -> socket.socket:
    """Return a listening socket of the loopback.

    Raises:
        UserError: the port is taken.
    """
    made = socket.socket()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        made.bind((ADDRESS, port))
    except OSError as error:
        made.close()
        raise UserError(
            f"cannot listen on {ADDRESS}:{port}: {error.strerror}", hint="choose another --port"
        ) from error
    made.listen(128)
    return made


def has_display() -> bool:
    """Whether a browser could show a page to the user."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_browser(address: str, report: Callable[[str], None]) -> None:
    """Open the user's browser in the background."""

    def call() -> None:
        started = time.monotonic()
        if not webbrowser.open(address) and time.monotonic() - started < 10:
            report("no browser could be started: open the address above")

    threading.Thread(target=call, daemon=True).start()

"""Runs the server of a page on the loopback until Ctrl-C or SIGTERM."""

from __future__ import annotations

import os
import secrets
import threading
import time
import webbrowser
from collections.abc import Callable

import attrs

from rigel_k8s.commands import releases
from rigel_k8s.commands.interruption import interruptible
from rigel_k8s.commands.targets import Release, release
from rigel_k8s.errors import UserError
from rigel_k8s.kube import connect
from rigel_k8s.release.types import Revision
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings
from rigel_ui.feed import Changes, Feed, Rollback
from rigel_ui.live import Live
from rigel_ui.logs import LogHub, read_log
from rigel_ui.readings import Readings, list_kinds
from rigel_ui.server import ADDRESS, PageServer


def serve(
    settings: Settings,
    job: str | None,
    report: Callable[[str], None],
    *,
    port: int,
    browser: bool,
    allow_changes: bool,
) -> None:
    """Serve the page of a release until Ctrl-C or SIGTERM.

    Args:
        report: takes lines for the terminal; the first one has the address.
        port: of the loopback; 0 is any that is free.
        browser: open it.
        allow_changes: a page may roll back.

    Raises:
        UserError: the port is taken.
    """
    found = release(settings, job)
    feed = Feed()
    logs = LogHub(read_log(found))
    changes = Changes(feed, make_rollback(found, settings)) if allow_changes else None
    feed.publish("server", {"server": {"changes": allow_changes}})
    live = Live(found, feed, report)
    readings = Readings(list_kinds(found))
    try:
        server = PageServer(port, feed, logs, secrets.token_urlsafe(24), changes, readings)
    except OSError as error:
        raise UserError(
            f"cannot listen on {ADDRESS}:{port}: {error.strerror}", hint="choose another --port"
        ) from error
    with found.cluster, interruptible() as cancel:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        report(f"http://{ADDRESS}:{server.port}/{server.token}/")
        live.start()
        has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        if browser and has_display:
            open_browser(f"http://{ADDRESS}:{server.port}/open/{server.tickets.issue()}", report)
        try:
            while not cancel.wait(1.0):
                pass
        finally:
            live.close()
            logs.close()
            if changes is not None and changes.running:
                report("interrupting the rollback")
                changes.close()
            server.close()


def make_rollback(found: Release, settings: Settings) -> Rollback:
    """Return what rolls a release back, by a connection of its own."""

    def call(number: int, report: Reporter, cancel: threading.Event) -> Revision:
        own = attrs.evolve(found, cluster=connect(settings))
        return releases.rollback(own, settings, number, report, cancel)

    return call


def open_browser(address: str, report: Callable[[str], None]) -> None:
    """Open the user's browser in the background."""

    def call() -> None:
        started = time.monotonic()
        if not webbrowser.open(address) and time.monotonic() - started < 10:
            report("no browser could be started: open the address above")

    threading.Thread(target=call, daemon=True).start()

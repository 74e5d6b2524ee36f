"""Whether the agent is connected to its broker, for Kubernetes' probe."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class _Handler(BaseHTTPRequestHandler):
    timeout = 10

    def __init__(self, is_well: Callable[[], bool], *arguments: object) -> None:
        self._is_well = is_well
        super().__init__(*arguments)  # type: ignore[arg-type]  # what the server passes

    def do_GET(self) -> None:
        well = self._is_well()
        body = b"connected to the broker\n" if well else b"not connected to the broker\n"
        self.send_response(200 if well else 503)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: a line for each probe would hide all others."""


@contextmanager
def serve_health(port: int | None, is_well: Callable[[], bool]) -> Iterator[None]:
    """Answer 200 or 503 on a port meanwhile; None for no port."""
    if port is None:
        yield
        return
    with ThreadingHTTPServer(("", port), partial(_Handler, is_well)) as server:
        thread = threading.Thread(target=server.serve_forever, name="health", daemon=True)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()

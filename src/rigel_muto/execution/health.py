"""Whether the agent is connected to its broker, and why not, for Kubernetes' probe."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer


class _Handler(BaseHTTPRequestHandler):
    timeout = 10

    def __init__(self, find_trouble: Callable[[], str], *arguments: object) -> None:
        self._find_trouble = find_trouble
        super().__init__(*arguments)  # type: ignore[arg-type]  # what the server passes

    def do_GET(self) -> None:
        trouble = self._find_trouble()
        body = f"{trouble or 'connected to the broker'}\n".encode()
        self.send_response(503 if trouble else 200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: a line for each probe would hide all others."""


@contextmanager
def serve_health(port: int | None, find_trouble: Callable[[], str]) -> Iterator[None]:
    """Answer 200, or 503 with the trouble, on a port meanwhile; None for no port."""
    if port is None:
        yield
        return
    with ThreadingHTTPServer(("", port), partial(_Handler, find_trouble)) as server:
        thread = threading.Thread(target=server.serve_forever, name="health", daemon=True)
        thread.start()
        try:
            yield
        finally:
            server.shutdown()

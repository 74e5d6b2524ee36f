"""/metrics and /healthz over HTTP; collection.py makes their contents."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from rigel_exporter.metrics import CONTENT_TYPE


class Server(ThreadingHTTPServer):
    """Serves on all addresses, IPv4 and IPv6 if the machine has both."""

    daemon_threads = True
    address_family = socket.AF_INET6 if socket.has_dualstack_ipv6() else socket.AF_INET

    def __init__(self, port: int, metrics: Callable[[], str], well: Callable[[], bool]) -> None:
        """Take the port (0: a free one); `serve_forever` answers.

        Raises:
            OSError: the port is taken.
        """
        self.metrics, self.well = metrics, well
        super().__init__(("", port), _Handler)

    def server_bind(self) -> None:
        """Take IPv4 and IPv6 at once."""
        if self.address_family == socket.AF_INET6:
            self.socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        super().server_bind()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Log nothing about a client that stopped waiting, such as a probe on a busy machine."""
        if not isinstance(sys.exc_info()[1], ConnectionError):
            super().handle_error(request, client_address)


class _Handler(BaseHTTPRequestHandler):
    server: Server
    timeout = 10

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if path == "/metrics":
            self._answer(200, self.server.metrics())
        elif path == "/healthz":
            well = self.server.well()
            self._answer(200 if well else 503, "ok\n" if well else "no look at the graph yet\n")
        else:
            self._answer(404, "not found: use /metrics or /healthz\n")

    do_HEAD = do_GET

    def _answer(self, status: int, text: str) -> None:
        body = text.encode()
        self.send_response(status)
        self.send_header("Content-Type", CONTENT_TYPE)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: there would be a line for each scrape and nothing else."""

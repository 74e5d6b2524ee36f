"""A registry of images that has one tag, `app:1`."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

DIGEST = "sha256:" + "ab" * 32


class TagRegistry(ThreadingHTTPServer):
    """Answers with `digest`, and counts how often it was asked."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Answer)
        self.digest, self.asked = DIGEST, 0

    @property
    def host(self) -> str:
        """HOST:PORT."""
        return f"127.0.0.1:{self.server_address[1]}"


class _Answer(BaseHTTPRequestHandler):
    server: TagRegistry

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""

    def do_HEAD(self) -> None:
        self.server.asked += 1
        known = self.path == "/v2/app/manifests/1"
        self.send_response(200 if known else 404)
        if known:
            self.send_header("Docker-Content-Digest", self.server.digest)
        self.end_headers()

    def do_GET(self) -> None:
        """Say that it does not have an image, as a registry does; the others are only asked for."""
        self.send_response(404)
        self.end_headers()
        self.wfile.write(b'{"errors": [{"code": "MANIFEST_UNKNOWN"}]}')


@contextmanager
def serve_tags() -> Iterator[TagRegistry]:
    """Serve as long as the context is open."""
    with TagRegistry() as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()

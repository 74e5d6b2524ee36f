"""Looks at the graph in the background, so a scrape of /metrics never waits."""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

from rigel_exporter import __version__
from rigel_exporter.config import Config
from rigel_exporter.graph import Half
from rigel_exporter.listening import Listening
from rigel_exporter.metrics import CONTENT_TYPE, Sample, text
from rigel_exporter.standing import Contract, Standing

#: Seconds between two readings of the subscribers.
_TICK = 1.0
#: Seconds without a look, beyond the interval, after which the exporter is not healthy.
PATIENCE = 60.0
_STARTED = time.time()


class Collection:
    """The thread that looks, and its latest result."""

    def __init__(self, half: Half, config: Config, *, after: float = 0.0) -> None:
        """Do nothing yet; the first look is `after` seconds after the start."""
        self._half, self._config, self._after = half, config, after
        self._listening = Listening(half, config)
        self._standing = Standing(config.expected, config.known, config.topics, config.once)
        self._contract = Contract(config.contract)
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name="looks", daemon=True)
        self._took = self._last = 0.0
        self._failures = 0

    def start(self) -> None:
        """Start to look."""
        self._thread.start()

    def close(self) -> None:
        """Stop looking."""
        self._ended.set()
        self._thread.join(PATIENCE)

    def well(self) -> bool:
        """Return whether there was a look, and not too long ago."""
        return bool(self._last) and time.time() - self._last < self._config.interval + PATIENCE

    def metrics(self) -> str:
        """Return all metrics as text."""
        with self._lock:
            return text(self._samples())

    def _samples(self) -> Iterator[Sample]:
        yield from self._describe_itself()
        yield from _process()
        if self._last:
            yield from self._standing.samples()
            yield from self._contract.samples()
        yield from self._listening.samples(time.time())

    def _describe_itself(self) -> Iterator[Sample]:
        middleware = self._config.middleware
        info = {"version": __version__, "ros": self._config.ros, "middleware": middleware}
        yield Sample("ros_exporter_info", 1, info)
        yield Sample("ros_exporter_failures_total", self._failures + self._listening.unreadable)
        if self._last:
            yield Sample("ros_exporter_collect_seconds", self._took)
            yield Sample("ros_exporter_last_collect_timestamp_seconds", self._last)

    def _run(self) -> None:
        self._ended.wait(self._after)
        while not self._ended.is_set():
            began = time.monotonic()
            self._look()
            self._wait(began + self._config.interval)

    def _wait(self, until: float) -> None:
        while not self._ended.wait(max(0.0, min(_TICK, until - time.monotonic()))):
            self._listening.refresh(time.time())
            if time.monotonic() >= until:
                return

    def _look(self) -> None:
        began = time.monotonic()
        try:
            graph = self._half.look()
        except Exception:  # one look of many: log it, count it, continue
            traceback.print_exc(file=sys.stderr)
            self._failures += 1
            return
        with self._lock:
            self._standing.take(graph, time.time())
            self._contract.take(graph, time.monotonic())
            self._took, self._last = time.monotonic() - began, time.time()


def _process() -> Iterator[Sample]:
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[1])
    yield Sample("process_cpu_seconds_total", time.process_time())
    yield Sample("process_resident_memory_bytes", pages * os.sysconf("SC_PAGE_SIZE"))
    yield Sample("process_start_time_seconds", _STARTED)


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

"""Whether a container's log goes on, asked of a small server that is as slow as a busy machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import pytest

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.target import Target

SLOW = 0.05  # seconds that an answer takes
CONTAINER = ("n", "talker", "node")


class Kubelet(BaseHTTPRequestHandler):
    """Answers slowly; a log that is followed ends twice as slowly, or with its container."""

    protocol_version = "HTTP/1.1"
    runs: threading.Event | None = None
    status = 200

    def do_GET(self) -> None:
        follows = "follow=true" in self.path
        if follows and self.runs is not None:
            self.runs.wait(60)
        time.sleep(2 * SLOW if follows else SLOW)
        self.send_response(self.status)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Say nothing."""


@pytest.fixture
def kubelet() -> Iterator[type[Kubelet]]:
    """A kubelet behind an API server, as the test wants it."""
    own = type("Own", (Kubelet,), {})
    server = ThreadingHTTPServer(("127.0.0.1", 0), own)
    server.daemon_threads = True
    own.cluster = Cluster(Target(f"http://127.0.0.1:{server.server_port}", "test"))  # type: ignore[attr-defined]
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    yield own
    own.cluster.close()  # type: ignore[attr-defined]
    server.shutdown()
    server.server_close()


def test_a_slow_machine_gets_the_time_to_tell_of_an_end(kubelet: Any) -> None:
    """Half a second is much where answers are quick; here it would end before the log does."""
    assert not kubelet.cluster.runs(*CONTAINER, seconds=0.02)


def test_a_container_that_runs_is_not_waited_for_for_ever(kubelet: Any) -> None:
    """Its log does not end as long as it runs."""
    kubelet.runs = threading.Event()
    assert kubelet.cluster.runs(*CONTAINER, seconds=0.02)
    kubelet.runs.set()


@pytest.mark.parametrize("status", [403, 404, 500])
def test_who_may_not_read_logs_knows_nothing(kubelet: Any, status: int) -> None:
    """That is no reason to call a node ended."""
    kubelet.status = status
    assert kubelet.cluster.runs(*CONTAINER, seconds=0.02)

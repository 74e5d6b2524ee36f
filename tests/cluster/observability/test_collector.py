"""The collector's own program, with the configuration that is deployed, and a Loki of ours."""

from __future__ import annotations

import gzip
import re
import subprocess
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import pairwise
from pathlib import Path
from typing import Any, TextIO

import pytest
import yaml

from rigel_lab.cluster import components

from ...support.until import until
from ...unit.observability.shapes import config, find, release

pytestmark = pytest.mark.cluster


class Loki(ThreadingHTTPServer):
    """Keeps the numbers of the lines that it gets."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.numbers: list[list[int]] = []

    def has(self, number: int) -> bool:
        """Return whether a line with a number has arrived."""
        return any(number in request for request in self.numbers)


class Handler(BaseHTTPRequestHandler):
    """Takes lines."""

    server: Loki

    def do_POST(self) -> None:
        """Take the numbers of a request."""
        body = gzip.decompress(self.rfile.read(int(self.headers["Content-Length"])))
        self.server.numbers.append([int(one) for one in re.findall(rb"count (\d+)", body)])
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Keep silent."""


@pytest.fixture
def log(tmp_path: Path) -> Iterator[TextIO]:
    """The log of a container, as the kubelet has it."""
    file = tmp_path / "pods/robot_talker_0a0a0a0a-0000-0000-0000-000000000000/talker/0.log"
    file.parent.mkdir(parents=True)
    with file.open("a", buffering=1) as lines:
        yield lines


@contextmanager
def run_loki() -> Iterator[Loki]:
    """Run a Loki of ours."""
    with Loki() as loki:
        serving = threading.Thread(target=loki.serve_forever)
        serving.start()
        try:
            yield loki
        finally:
            loki.shutdown()
            serving.join()


@contextmanager
def run_collector(directory: Path, loki: int) -> Iterator[subprocess.Popen[bytes]]:
    """Run the collector on the files of a directory; only what asks Kubernetes is left out."""
    text = release("{}")
    made: dict[str, Any] = yaml.safe_load(config(text, "otel-collector", "collector.yaml"))
    made["extensions"]["health_check"]["endpoint"] = "127.0.0.1:0"
    made["extensions"]["file_storage"]["directory"] = str(directory / "state")
    made["receivers"]["file_log"] |= {
        "include": [f"{directory}/pods/*/*/*.log"],
        "resource": {"node": "here"},
    }
    logs = made["service"]["pipelines"]["logs"]
    logs["processors"] = [one for one in logs["processors"] if "k8s" not in one and "/r" not in one]
    made["processors"] = {name: made["processors"][name] for name in logs["processors"]}
    made["processors"]["memory_limiter"] = {"check_interval": "1s", "limit_mib": 200}
    made["exporters"]["otlp_http"]["endpoint"] = f"http://127.0.0.1:{loki}/otlp"
    made["service"]["telemetry"]["metrics"] = {"level": "none"}
    file = directory / "collector.yaml"
    file.write_text(yaml.safe_dump(made))
    program = components.obtain(print, ["observability"]).go["otelcol-k8s"]
    pod = find(text, "DaemonSet", "otel-collector")["spec"]["template"]["spec"]
    words = [program, f"--config={file}", *pod["containers"][0]["args"][1:]]
    with (
        (directory / "output").open("ab") as output,
        subprocess.Popen(words, stdout=output, stderr=output) as process,
    ):
        try:
            yield process
        finally:
            process.terminate()


def write(log: TextIO, numbers: Iterable[int], every: float) -> None:
    """Write a line for each number, with some seconds between."""
    for number in numbers:
        at = f"{number // 1000:02d}.{number % 1000:03d}"
        log.write(f"2026-01-01T00:00:{at}Z stdout F count {number}\n")
        time.sleep(every)


def test_a_killed_collector_loses_what_waits_to_be_joined(tmp_path: Path, log: TextIO) -> None:
    """At each kill at most the last line of a container, at 500 lines a second."""
    kills, size = 12, 700
    with run_loki() as loki:
        for first in range(0, kills * size, size):
            with run_collector(tmp_path, loki.server_port) as collector:
                write(log, range(first, first + size // 2), 0.002)
                until(partial(loki.has, first), "lines of this turn")
                killed = first + size - first // 31  # each time another moment
                write(log, range(first + size // 2, killed), 0.002)
                collector.kill()
                write(log, range(killed, first + size), 0)
        end = kills * size
        with run_collector(tmp_path, loki.server_port):
            write(log, range(end, end + 10), 0.1)
            until(partial(loki.has, end + 8), "the last lines")
    missing = [number for number in range(end) if not loki.has(number)]
    assert len(missing) <= kills, missing
    assert all(two - one > 1 for one, two in pairwise(missing)), missing

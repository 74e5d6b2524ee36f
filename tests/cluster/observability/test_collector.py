"""The collector's own program, with the configuration that is deployed, and a Loki of ours."""

from __future__ import annotations

import gzip
import re
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_lab.cluster import components

from ...support.until import until
from ...unit.observability.shapes import config, release

pytestmark = pytest.mark.cluster


class Slow(ThreadingHTTPServer):
    """A Loki that takes its time, and counts the requests that it handles at once."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.lock = threading.Lock()
        self.busy = self.most = 0
        self.numbers: list[list[int]] = []


class Handler(BaseHTTPRequestHandler):
    """Takes lines."""

    server: Slow

    def do_POST(self) -> None:
        """Take a request, but not before 0.3 s."""
        body = gzip.decompress(self.rfile.read(int(self.headers["Content-Length"])))
        with self.server.lock:
            self.server.busy += 1
            self.server.most = max(self.server.most, self.server.busy)
        time.sleep(0.3)
        with self.server.lock:
            self.server.busy -= 1
            self.server.numbers.append([int(one) for one in re.findall(rb"count (\d+)", body)])
        self.send_response(200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Keep silent."""


@contextmanager
def run_collector(directory: Path, loki: int) -> Iterator[None]:
    """Run the collector on the files of a directory; only what asks Kubernetes is left out."""
    made: dict[str, Any] = yaml.safe_load(config(release("{}"), "otel-collector", "collector.yaml"))
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
    with (
        (directory / "output").open("wb") as output,
        subprocess.Popen([program, f"--config={file}"], stdout=output, stderr=output) as process,
    ):
        try:
            yield
        finally:
            process.terminate()


def test_loki_has_one_request_of_a_machine_at_a_time(tmp_path: Path) -> None:
    """Loki 3.7 writes requests to its log in any order, and drops lines when it reads it again."""
    file = tmp_path / "pods/robot_talker_0a0a0a0a-0000-0000-0000-000000000000/talker/0.log"
    file.parent.mkdir(parents=True)
    with Slow() as loki:
        serving = threading.Thread(target=loki.serve_forever)
        serving.start()
        try:
            with run_collector(tmp_path, loki.server_port), file.open("a", buffering=1) as lines:
                for number in range(600):
                    lines.write(f"2026-01-01T00:00:00.{number:09d}Z stdout F count {number}\n")
                    time.sleep(0.005)
                until(
                    lambda: sum(len(one) for one in loki.numbers) >= 600,
                    "all lines",
                    last_words=(tmp_path / "output").read_text,
                )
        finally:
            loki.shutdown()
            serving.join()
    assert [number for one in loki.numbers for number in one] == list(range(600))
    assert len(loki.numbers) > 3
    assert loki.most == 1

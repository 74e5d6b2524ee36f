"""The collector's own program, with the configuration that is deployed, and a Loki of ours."""

from __future__ import annotations

import gzip
import re
import subprocess
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import yaml

from rigel_lab.cluster import components

from ..unit.observability.shapes import config, find, release

#: The log of a container below a directory, as the kubelet has it.
LOG = "pods/robot_talker_0a0a0a0a-0000-0000-0000-000000000000/talker/0.log"


class Loki(ThreadingHTTPServer):
    """Counts how often it gets the line of each number.

    Attributes:
        away: it refuses what it gets, as one that starts does.
    """

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.numbers: Counter[int] = Counter()
        self.away = False

    def has(self, number: int) -> bool:
        """Return whether a line with a number has arrived."""
        return number in self.numbers


class Handler(BaseHTTPRequestHandler):
    """Takes lines."""

    server: Loki

    def do_POST(self) -> None:
        """Take the numbers of a request."""
        body = gzip.decompress(self.rfile.read(int(self.headers["Content-Length"])))
        if not self.server.away:
            self.server.numbers.update(map(int, re.findall(rb"count (\d+)", body)))
        self.send_response(503 if self.server.away else 200)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def log_message(self, *_: object) -> None:
        """Keep silent."""


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
def run_collector(
    directory: Path, loki: int, storage: dict[str, Any] | None = None
) -> Iterator[subprocess.Popen[bytes]]:
    """Run the collector on the files of a directory; only what asks Kubernetes is left out.

    Args:
        loki: the port of Loki.
        storage: what differs in the configuration of its storage.
    """
    text = release("{}")
    made: dict[str, Any] = yaml.safe_load(config(text, "otel-collector", "collector.yaml"))
    made["extensions"]["health_check"]["endpoint"] = "127.0.0.1:0"
    made["extensions"]["file_storage"] |= {"directory": f"{directory}/state", **(storage or {})}
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


def line_of(number: int) -> str:
    """Return a line of a container's log, as the kubelet writes it."""
    seconds, rest = divmod(number, 1000)
    minutes, seconds = divmod(seconds, 60)
    hours, minutes = divmod(minutes, 60)
    at = f"{hours:02d}:{minutes:02d}:{seconds:02d}.{rest:03d}"
    return f"2026-01-01T{at}Z stdout F count {number}\n"

"""The observability stack of the test cluster, deployed once, and questions to it."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import attrs
import pytest

from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.reading.stack import find_namespace
from tests.support import until as waiting

from ...support import shared
from ..conftest import run_rigel

T = TypeVar("T")

#: What all tests here share: without Grafana, whose image cannot be had everywhere.
OPTIONS: dict[str, Any] = {"grafana": {"enabled": False}, "node_exporter": True}
#: Lines that Loki gives at once.
PAGE = 5000
#: Seconds: a pod's start on a busy machine, and a few scrapes.
PATIENCE = 240.0


def until(look: Callable[[], T], what: str, patience: float = PATIENCE) -> T:
    """Return what a look gives as soon as it is anything.

    Behind the Service of a part that was restarted nothing is ready for a moment: an error.
    """
    return waiting.until(look, what, patience, every=0.5, despite=(ClusterError,))


@attrs.frozen
class Stack:
    """The stack in its namespace, asked through the API server.

    Attributes:
        user: the options with which `rigel` deploys it; those of the context's user otherwise.
    """

    cluster: Any
    context: str
    namespace: str
    file: Path
    user: Sequence[str] = ()

    def deploy(self, options: dict[str, Any] | None = None, *words: str) -> str:
        """Deploy it with options, and return what was told."""
        job = {"plugin": "rigel_k8s.ObservabilityPlugin", "with": {**OPTIONS, **(options or {})}}
        jobs = {"application": {"distro": "noetic"}, "jobs": {"stack": job}}
        self.file.write_text(json.dumps(jobs))
        user = self.user or ("--context", self.context)
        done = run_rigel(*user, "-f", str(self.file), "run", "job", "stack", *words)
        return done.stdout + done.stderr

    def ask(self, service: str, port: int, path: str, **query: object) -> Any:
        """Return what a Service of the stack answers."""
        ref = ObjectRef("v1", "Service", self.namespace, service)
        answer = json.loads(self.cluster.get_through_proxy(ref, path, port=port, query=query))
        assert answer["status"] == "success", answer
        return answer["data"]

    def loki(self, query: str) -> list[dict[str, Any]]:
        """Return the streams of the last hour that a LogQL query finds, lines oldest first."""
        start = (int(time.time()) - 3600) * 10**9
        words = {"query": query, "start": start, "limit": PAGE, "direction": "forward"}
        found = self.ask("loki", 3100, "loki/api/v1/query_range", **words)
        streams: list[dict[str, Any]] = found["result"]
        return streams

    def lines(self, query: str, *, hours: int = 1) -> list[tuple[int, str]]:
        """Return (time in ns, line) of all streams that a query finds, in order, however many."""
        start = (int(time.time()) - 3600 * hours) * 10**9
        found: list[tuple[int, str]] = []
        while page := self._page(query, start):
            found += page
            start = page[-1][0] + 1
        return found

    def _page(self, query: str, start: int) -> list[tuple[int, str]]:
        words = {"query": query, "start": start, "limit": PAGE, "direction": "forward"}
        streams = self.ask("loki", 3100, "loki/api/v1/query_range", **words)["result"]
        return sorted((int(at), line) for one in streams for at, line in one["values"])

    def metrics(self, query: str) -> list[dict[str, Any]]:
        """Return the samples that a PromQL query finds now."""
        found: list[dict[str, Any]] = self.ask("prometheus", 9090, "api/v1/query", query=query)[
            "result"
        ]
        return found

    def pods(self, part: str) -> list[dict[str, Any]]:
        """Return a part's pods that stay."""
        labels = {"app.kubernetes.io/name": part}
        found = self.cluster.list("v1", "Pod", self.namespace, labels=labels)
        return [pod for pod in found if not pod["metadata"].get("deletionTimestamp")]

    def restart(self, part: str) -> None:
        """Delete a part's pods, and return when new ones are ready."""
        old = {pod["metadata"]["uid"] for pod in self.pods(part)}
        self.end(part)
        until(lambda: self.has_anew(part, old), f"{part} is back")

    def end(self, part: str) -> None:
        """Delete a part's pods."""
        for pod in self.pods(part):
            name = pod["metadata"]["name"]
            self.cluster.delete(ObjectRef("v1", "Pod", self.namespace, name))

    def has_anew(self, part: str, old: set[str]) -> bool:
        """Whether as many pods as the old ones, named by their UIDs, are ready."""
        new = [pod for pod in self.pods(part) if pod["metadata"]["uid"] not in old]
        return len(new) >= len(old) and all(is_ready(pod) for pod in new)


def is_ready(pod: dict[str, Any]) -> bool:
    """Whether a pod is ready."""
    conditions = pod.get("status", {}).get("conditions", [])
    return any(c["type"] == "Ready" and c["status"] == "True" for c in conditions)


@pytest.fixture(scope="session", autouse=True)
def _images(context: str) -> None:
    """The stack's images in the local cluster's registry."""
    offer("observability")


@pytest.fixture(scope="session")
def more_images(context: str) -> None:
    """The images of what few tests use."""
    from rigel_lab.cluster.addons import EXTRAS

    for extra in EXTRAS.keys() - {"multus", "observability"}:
        offer(extra)


def offer(extra: str) -> None:
    """Put an extra's images into the local cluster's registry."""
    if not shared.possible():
        return
    build = f"from rigel_lab.cluster import components; components.obtain(print, ['{extra}'])"

    def do() -> None:
        subprocess.run(["nice", "-n", "19", sys.executable, "-c", build], check=True)
        run_rigel("cluster", "up", "--name", shared.NAME, "--with", extra)

    shared.once(f"extra {extra}", do)


@pytest.fixture(scope="session")
def watching(
    cluster: Any, context: str, installer: list[str], tmp_path_factory: pytest.TempPathFactory
) -> Stack:
    """The cluster's one stack, deployed once for all processes; the run's end takes it away.

    It is deployed by a user who has the ClusterRole for installers and nothing else.
    """
    ours = shared.directory() / shared.STACK
    if not ours.exists() and (there := find_namespace(cluster)):
        namespace = there
    else:
        namespace = "monitoring"
        ours.write_text(namespace)
    file = tmp_path_factory.mktemp("stack") / "Rigelfile"
    stack = Stack(cluster, context, namespace, file, installer)
    shared.once("stack is deployed", stack.deploy)
    return stack


@pytest.fixture(scope="session")
def stack(watching: Stack) -> str:
    """The namespace of the cluster's one stack."""
    return watching.namespace

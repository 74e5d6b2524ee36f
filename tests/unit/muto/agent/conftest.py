"""An agent's executor on the fake cluster, with a Rigelfile and a Ditto that is away or there."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_graph import reading
from rigel_graph.types import RosGraph
from rigel_k8s import kube
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings
from rigel_muto.agent.allowance import Allowance
from rigel_muto.agent.memory import Memory
from rigel_muto.agent.wanted import Record
from rigel_muto.execution import executor as executors
from rigel_muto.execution import target
from rigel_muto.execution.executor import ReleaseExecutor
from rigel_muto.execution.target import DeployedJob
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder
from tests.support.until import until

RELEASE = ReleaseId("n", "robot")
IMAGE = "lab/robot@sha256:" + "ab" * 32
ALL = Allowance(whole_stacks=True)


def stack(identifier: str, *names: str, **more: Any) -> str:
    """Return the text of a stack with nodes of these names."""
    nodes = [{"name": name, "pkg": "demo", "exec": name} for name in names]
    return json.dumps({"stackId": identifier, "node": nodes, **more})


@attrs.define
class Agent:
    """An agent without a broker; `run` starts one, as if the one before was killed.

    Attributes:
        looking: held while an agent looks at the release, or while a test keeps it from looking.
    """

    fake: FakeCluster
    report: Recorder
    directory: Path
    states: list[tuple[str, str]] = attrs.field(factory=list)
    causes: list[str] = attrs.field(factory=list)
    looking: threading.Lock = attrs.field(factory=threading.Lock)
    _running: list[ReleaseExecutor] = attrs.field(factory=list)

    def run(self, allowance: Allowance = ALL, *, timeout: float = 30) -> ReleaseExecutor:
        settings = Settings(rigelfile=self.directory / "Rigelfile", timeout=timeout)
        application = DeployedJob(settings, self.report)
        named = application.creates_namespace()
        made = ReleaseExecutor(
            application,
            Memory(self.fake, RELEASE, create_namespace=named),  # type: ignore[arg-type]
            allowance,
            self.announce,
        )
        self._running.append(made)
        made.start()
        return made

    def announce(self, record: Record) -> None:
        self.states.append((record.label, record.state))
        self.causes.append(record.cause)

    def until(self, *state: str) -> None:
        until(lambda: self.states[-1] == state, f"{state}, now {self.states}")

    @property
    def nodes(self) -> set[str]:
        return self.fake.names("Deployment")

    def close(self) -> None:
        for one in self._running:
            one.close()


@pytest.fixture
def agent(
    fake: FakeCluster, report: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Agent]:
    """An agent whose Rigelfile deploys the release `robot` into the namespace `n`."""
    monkeypatch.setattr(kube, "connect", lambda settings: fake)
    monkeypatch.setattr(target, "connect", lambda settings: fake)
    monkeypatch.setattr(reading, "read_graph", lambda *_, **__: RosGraph())
    monkeypatch.setattr(executors, "LOOK", 0.1)
    look = DeployedJob.look

    def look_alone(self: DeployedJob) -> tuple[int, list[str]]:
        with made.looking:
            return look(self)

    monkeypatch.setattr(DeployedJob, "look", look_alone)
    job = {
        "namespace": RELEASE.namespace,
        "deployment_name": RELEASE.name,
        "image": IMAGE,
        "ros_master_uri": "http://robot:11311",
    }
    deploy = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": job}
    text = json.dumps({"application": {"distro": "noetic"}, "jobs": {"deploy": deploy}})
    (tmp_path / "Rigelfile").write_text(text)
    (tmp_path / "stacks.json").write_text(f"[{stack('org:a', 'a', 'both')}]")
    (tmp_path / "b.json").write_text(stack("org:b", "b", "both"))
    made = Agent(fake, report, tmp_path)
    yield made
    made.close()


@pytest.fixture
def pods(fake: FakeCluster) -> Callable[[str], str]:
    """Return the UID of a node's pod."""

    def find(name: str) -> str:
        (pod,) = fake.list("v1", "Pod", "n", labels={"app.kubernetes.io/name": name})
        return str(pod["metadata"]["uid"])

    return find

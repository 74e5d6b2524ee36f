"""What `rigel status` learns from the gate, which is asked in its own container."""

from __future__ import annotations

import json
import os
import socketserver
import threading
import xmlrpc.server
from collections.abc import Iterator
from typing import Any

import pytest

from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.objects import pods
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rosgraph import gate as module
from rigel_k8s.rosgraph.handover import GateStatus, NameConflict, WaitingNode, read_gate

from .local import LocalCluster

pytestmark = pytest.mark.programs

RELEASE = ReleaseId("robots", "explorer")
ANSWER = {
    "waiting": [{"node": "/talker", "api": "http://10.0.0.2:1/", "owner": "http://10.0.0.1:1/"}],
    "conflicts": [
        {"node": "/map", "old": "http://10.0.0.3:1/", "new": "http://10.0.0.4:1/", "time": 3.5}
    ],
    "silent": ["/camera"],
    "has_master": False,
    "restarts": 2,
    "nodes": 7,
    "blocked": "the new master cannot be given its registrations",
    "refused": ["service /ask of /talker at http://10.0.0.2:1/: bug"],
    "unkept": ["the memory is not kept in the cluster: away"],
}


class MasterCluster(LocalCluster):
    """A cluster with a ros-master pod that is this machine."""

    def __init__(self, *containers: str, state: str = "running") -> None:
        super().__init__(PATH=os.environ["PATH"])
        self.containers, self.state = containers, state

    def list(self, api_version: str, kind: str, namespace: str, *, labels: Any) -> list[Any]:
        assert labels == {"rigel-k8s/release": "explorer", "app.kubernetes.io/name": "ros-master"}
        states = [{"name": name, "state": {self.state: {}}} for name in self.containers]
        return [
            {
                "metadata": {"name": "ros-master-1"},
                "spec": {"containers": [{"name": name} for name in self.containers]},
                "status": {"containerStatuses": states},
            }
        ]


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A server that describes itself as a gate does."""
    server = xmlrpc.server.SimpleXMLRPCServer(("127.0.0.1", 0), logRequests=False)
    server.register_function(lambda _: [1, "", json.dumps(ANSWER)], "rigelDescribeGate")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    ask = module.ASK.replace(str(pods.MASTER_PORT), str(server.server_address[1]))
    monkeypatch.setattr(module, "ASK", ask)
    yield
    server.shutdown()
    server.server_close()


@pytest.mark.usefixtures("answering")
def test_a_gate_is_asked_in_its_pod() -> None:
    """What it answers, as values."""
    cluster = MasterCluster("ros-master", "gate")
    assert read_gate(cluster, RELEASE) == GateStatus(  # type: ignore[arg-type]
        waiting=(WaitingNode("/talker", "http://10.0.0.2:1/", "http://10.0.0.1:1/"),),
        conflicts=(NameConflict("/map", "http://10.0.0.3:1/", "http://10.0.0.4:1/", 3.5),),
        silent=("/camera",),
        has_master=False,
        restarts=2,
        blocked="the new master cannot be given its registrations",
        refused=("service /ask of /talker at http://10.0.0.2:1/: bug",),
        unkept=("the memory is not kept in the cluster: away",),
    )
    assert cluster.pods == ["ros-master-1"]


def test_a_master_without_a_gate_is_not_asked() -> None:
    """Nor one whose gate does not run."""
    for cluster in (MasterCluster("ros-master"), MasterCluster("gate", state="waiting")):
        assert read_gate(cluster, RELEASE) is None  # type: ignore[arg-type]
        assert cluster.pods == []


def test_a_gate_that_cannot_be_asked_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    """A right that is missing, no answer: status goes on without it."""
    with socketserver.TCPServer(("127.0.0.1", 0), socketserver.BaseRequestHandler) as server:
        port = server.server_address[1]
    monkeypatch.setattr(module, "ASK", module.ASK.replace(str(pods.MASTER_PORT), str(port)))
    found = read_gate(MasterCluster("gate"), RELEASE)  # type: ignore[arg-type]
    assert found is not None
    assert "Connection refused" in found.problem

    def refuse(*_: Any, **more: Any) -> Any:
        raise Forbidden("no")

    monkeypatch.setattr(MasterCluster, "run", refuse)
    found = read_gate(MasterCluster("gate"), RELEASE)  # type: ignore[arg-type]
    assert found is not None
    assert "pods/exec" in found.problem

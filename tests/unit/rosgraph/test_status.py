"""How `rigel status` compares topics with what is expected of them."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_graph import reading
from rigel_graph.discovery.findings import DiscoveryGraph, graph
from rigel_graph.discovery.looks import look
from rigel_graph.discovery.members import members
from rigel_graph.status import judge_topics
from rigel_graph.types import GraphTopic, RosGraph
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.execution import ExecResult
from rigel_k8s.release import revisions
from rigel_k8s.release.status import ReleaseStatus
from rigel_k8s.release.types import ReleaseId, Revision
from tests.support.members import pod
from tests.support.notes import NOW, SECOND, answer, process, publisher

ROBOT = ReleaseId("robots", "robot")
LIDAR = pod("lidar-1", env=[{"name": "RIGEL_RMW", "value": "/rmw"}])


def release(**expect: Any) -> ReleaseStatus:
    """A release whose last good revision expects something of topics, by their last names."""
    options = {"expect": {f"/{name}": one for name, one in expect.items()}}
    record = revisions.record(Revision(ROBOT, 1, "good", "", (), (), options))
    return ReleaseStatus(ROBOT, 1, "good", (), 1, last_good=record)


def see(item: Any, *discovered: str) -> DiscoveryGraph:
    """The DDS graph of a pod whose node has published three messages during the look."""

    def run(*_: Any, **__: Any) -> ExecResult:
        first, second = (
            answer(process("/lidar", parts=[publisher("/lidar", "/scan", count)]), now=now)
            for count, now in ((10, NOW - SECOND), (13, NOW))
        )
        second["processes"][0]["seen"] = ["/lidar", *discovered]
        return ExecResult(0, json.dumps({"first": first, "second": second}).encode(), b"")

    cluster: Any = SimpleNamespace(run=run, parallel=lambda call, items: [call(i) for i in items])
    found = members([item])
    return graph(found, look(cluster, found))


def judge(state: ReleaseStatus, item: Any, seen: DiscoveryGraph | None) -> dict[str, str] | None:
    """Return what is known to be broken or unknown, and its line."""
    cluster: Any = None
    found = judge_topics(cluster, state, [item], seen)
    if found is None:
        return None
    return {"/".join(one.key): one.finding.state if not one.broken else one.line for one in found}


def test_what_was_noted_for_discovery_is_enough() -> None:
    """No second reading makes `status` slower."""
    state = release(scan={"rate": "8..12", "publishers": 1}, map={"publishers": 1})
    assert judge(state, LIDAR, see(LIDAR)) == {
        "/scan/rate": "/scan: rate 3/s, expected 8..12/s",
        "/scan/publishers": "ok",
        "/map/publishers": "/map: publishers 0, expected 1",
    }


def test_what_other_nodes_may_do_is_unknown() -> None:
    """They were discovered, and have not been asked."""
    state = release(scan={"rate": "8..12", "publishers": 2}, map={"rate": 1, "publishers": 1})
    assert judge(state, LIDAR, see(LIDAR, "/elsewhere")) == {
        "/scan/rate": "/scan: rate 3/s, expected 8..12/s",
        "/scan/publishers": "unknown",
        "/map/rate": "unknown",
        "/map/publishers": "unknown",
    }


def test_nothing_is_judged_without_a_reading() -> None:
    """As without the library, or where no command may run in pods."""
    assert judge(release(scan={"publishers": 1}), LIDAR, DiscoveryGraph((), (), ())) is None
    assert judge(release(), LIDAR, see(LIDAR)) is None


def test_ros1_is_asked_only_if_something_is_expected(monkeypatch: pytest.MonkeyPatch) -> None:
    topic = GraphTopic("/scan", publishers=("/lidar",), rate=3.0)
    monkeypatch.setattr(reading, "read_graph", lambda *_, **__: RosGraph((), (topic,), span=1.0))
    line = "/scan: rate 3/s, expected 8..12/s"
    assert judge(release(scan={"rate": "8..12"}), LIDAR, None) == {"/scan/rate": line}

    def fail(*_: Any, **__: Any) -> RosGraph:
        raise ClusterError("roscore does not run")

    monkeypatch.setattr(reading, "read_graph", fail)
    assert judge(release(scan={"rate": "8..12"}), LIDAR, None) is None
    monkeypatch.setattr(reading, "read_graph", lambda *_, **__: pytest.fail("asked"))
    assert judge(release(), LIDAR, None) is None

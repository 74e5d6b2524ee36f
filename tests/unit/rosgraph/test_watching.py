"""How a watched update reads rates, and what it makes of several readings."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import pytest

from rigel_exporter.collection import Server
from rigel_exporter.metrics import Sample, text
from rigel_inpod.sent import heard
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.execution import ExecResult
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rosgraph import watching
from rigel_k8s.rosgraph.types import GraphNode, GraphTopic, RosGraph

RELEASE = ReleaseId("robots", "explorer")


@pytest.fixture
def exporter() -> Iterator[str]:
    """The port of an exporter that has heard five more messages of /scan at each look."""
    looks = iter(range(0, 1000, 5))

    def metrics() -> str:
        name = "ros_topic_messages_total"
        return text(
            [
                Sample(name, next(looks), {"topic": "/scan"}),
                Sample(name, 7, {"topic": "/still"}),
                Sample("ros_topic_publishers", 1, {"topic": "/scan"}),
            ]
        )

    with Server(0, metrics, lambda: True) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield str(server.server_address[1])
        server.shutdown()
        thread.join()


def test_rates_are_what_the_exporter_hears_between_two_looks(
    exporter: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A topic that is silent has the rate 0: that it is silent is known."""
    monkeypatch.setattr(heard, "SPAN", 0.1)
    heard.main(exporter)
    rates = json.loads(capsys.readouterr().out)
    assert rates.keys() == {"/scan", "/still"}
    assert 5 < rates["/scan"] <= 50
    assert rates["/still"] == 0


def test_an_exporter_that_does_not_answer_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    heard.main("1")
    assert "the ROS exporter does not answer" in json.loads(capsys.readouterr().out)["error"]


class Cluster:
    """A release with an exporter, whose pod answers a program with `answer`."""

    def __init__(self, answer: object, ros: str = "2") -> None:
        self.answer = answer
        self.ros = ros
        self.asked: list[str] = []

    def list(self, *_: Any, **__: Any) -> list[dict[str, Any]]:
        return [self.pod("lidar"), self.pod("ros-exporter")]

    def pod(self, workload: str) -> dict[str, Any]:
        note = json.dumps({"mode": "none", "ros": self.ros})
        return {
            "metadata": {
                "name": f"{workload}-1",
                "namespace": "robots",
                "labels": {"app.kubernetes.io/name": workload},
                "annotations": {"rigel-k8s/network": note},
            },
            "spec": {"containers": [{"name": "c"}]},
            "status": {"containerStatuses": [{"name": "c", "state": {"running": {}}}]},
        }

    def run(self, namespace: str, pod: str, *_: Any, **__: Any) -> ExecResult:
        self.asked.append(pod)
        if isinstance(self.answer, Exception):
            raise self.answer
        return ExecResult(0, json.dumps(self.answer).encode(), b"")


def test_the_exporter_of_dds_is_asked_in_its_pod() -> None:
    cluster: Any = Cluster({"/scan": 9.5})
    assert watching.read_rates(cluster, RELEASE) == {"/scan": 9.5}
    assert cluster.asked == ["ros-exporter-1"]


def test_nodes_of_ros_1_count_for_themselves() -> None:
    cluster: Any = Cluster({"/scan": 9.5}, ros="1")
    assert watching.read_rates(cluster, RELEASE) == {}
    assert cluster.asked == []


@pytest.mark.parametrize("answer", [ClusterError("no such pod"), {"error": "it does not answer"}])
def test_without_an_exporter_that_answers_there_are_no_rates(answer: object) -> None:
    cluster: Any = Cluster(answer)
    assert watching.read_rates(cluster, RELEASE) == {}


def test_rates_come_to_topics_that_have_none(monkeypatch: pytest.MonkeyPatch) -> None:
    read = RosGraph(topics=(GraphTopic("/a", rate=1.0), GraphTopic("/b"), GraphTopic("/c")))
    monkeypatch.setattr("rigel_k8s.rosgraph.reading.read_graph", lambda *_: read)
    cluster: Any = Cluster({"/a": 2.0, "/b": 3.0})
    found = watching.read_with_rates(cluster, RELEASE)
    assert [topic.rate for topic in found.topics] == [1.0, 3.0, None]


def test_of_several_looks_the_highest_rate_counts() -> None:
    """One look of a second is too short for a topic that comes once a second."""
    highest: dict[str, float] = {}
    rates = []
    for rate in (0.0, 1.0, 0.5, None):
        graph = RosGraph(topics=(GraphTopic("/slow", rate=rate), GraphTopic("/unknown")))
        kept = watching.keep_highest(graph, highest)
        rates.append([topic.rate for topic in kept.topics])
    assert rates == [[0.0, None], [1.0, None], [1.0, None], [1.0, None]]


def watch_graphs(monkeypatch: pytest.MonkeyPatch, *graphs: RosGraph) -> watching.GraphWatch:
    """Return a watch that reads these graphs: before the update, then one look after the other."""
    looks = iter(graphs)
    monkeypatch.setattr(watching, "AGAIN", 0.01)
    monkeypatch.setattr(watching, "read_with_rates", lambda *_: next(looks))
    cluster: Any = None
    reporter: Any = Mock()
    watch = watching.GraphWatch(cluster, RELEASE, reporter, threading.Event(), patience=0.0)
    watch._before = next(looks)
    return watch


def talking(*publishers: str, leaving: tuple[str, ...] = ()) -> RosGraph:
    node = GraphNode("/talker", pod="talker-1", workload="talker")
    topics = (GraphTopic("/chatter", "std_msgs/String", publishers),) if publishers else ()
    return RosGraph((node,), topics, leaving=leaving)


def test_the_old_nodes_leave_before_the_graph_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new pod is ready, and what the old one publishes is still there: it goes with it."""
    full, gone = talking("/talker"), talking()
    watch = watch_graphs(monkeypatch, full, talking("/talker", leaving=("/talker",)), gone)
    found = watch.find_differences()
    assert found is not None
    assert [line for line in found.worse if "/chatter" in line]


def test_pods_that_never_end_are_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their machine may be away."""
    monkeypatch.setattr(watching, "LEAVING", 0.0)
    full = talking("/talker")
    watch = watch_graphs(monkeypatch, full, talking("/talker", leaving=("/talker",)))
    found = watch.find_differences()
    assert found is not None
    assert found.worse == ()


def test_a_long_report_is_cut() -> None:
    """A master that is gone takes everything with it."""
    lines = tuple(f"line {number}" for number in range(50))
    assert watching.limit(lines[:20]) == lines[:20]
    cut = watching.limit(lines)
    assert cut == (*lines[:19], "and 31 more; `rigel graph` shows all")

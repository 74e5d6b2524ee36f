"""What a watched update makes of several readings of the graph."""

from __future__ import annotations

import threading
from typing import Any
from unittest.mock import Mock

import attrs
import pytest

from rigel_graph import reading, watching
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.types import Plan, ReleaseId, Step

RELEASE = ReleaseId("robots", "explorer")


def test_of_several_looks_the_highest_rate_counts() -> None:
    """One look of a second is too short for a topic that comes once a second."""
    highest: dict[str, float] = {}
    rates = []
    for rate in (0.0, 1.0, 0.5, None):
        graph = RosGraph(topics=(GraphTopic("/slow", rate=rate), GraphTopic("/unknown")))
        kept = watching.keep_highest(graph, highest)
        rates.append([topic.rate for topic in kept.topics])
    assert rates == [[0.0, None], [1.0, None], [1.0, None], [1.0, None]]


def watch_graphs(
    monkeypatch: pytest.MonkeyPatch, looks: list[RosGraph], pods: list[list[dict[str, Any]]]
) -> watching.GraphWatch:
    """Return a watch that reads these graphs: before the update, then one look after the other.

    Args:
        pods: the release's, look after look; the last ones stay.
    """
    monkeypatch.setattr(watching, "SOON", 0.01)
    monkeypatch.setattr(watching, "list_pods", lambda *_: pods.pop(0) if pods[1:] else pods[0])
    monkeypatch.setattr(watching, "read_graph", lambda *_: looks.pop(0))
    cluster: Any = None
    reporter: Any = Mock()
    watch = watching.GraphWatch(cluster, RELEASE, reporter, threading.Event(), patience=0.0)
    watch._before = looks.pop(0)
    return watch


def talking(*publishers: str) -> RosGraph:
    node = GraphNode("/talker", pod="talker-1", workload="talker")
    topics = (GraphTopic("/chatter", "std_msgs/String", publishers),) if publishers else ()
    return RosGraph((node,), topics)


ENDING = {
    "metadata": {
        "name": "old-1",
        "namespace": "robots",
        "labels": {"app.kubernetes.io/name": "old"},
        "annotations": {"rigel-k8s/ros-name": "/old"},
        "deletionTimestamp": "2026-01-01T00:00:00Z",
    },
    "spec": {"containers": [{"name": "ros-node"}]},
    "status": {},
}


def test_the_old_nodes_leave_before_the_graph_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """A new pod is ready, and what the old one publishes is still there: it goes with it."""
    pods: list[list[dict[str, Any]]] = [[ENDING], [ENDING], []]
    watch = watch_graphs(monkeypatch, [talking("/talker"), talking()], pods)
    found = watch.find_differences()
    assert pods == [[]]
    assert found is not None
    assert [line for line in found.worse if "/chatter" in line]
    waits = "/old is still in a pod that is being terminated; 60 s are given for that"
    watch.reporter.progress.assert_called_with("ROS graph", waits)  # type: ignore[attr-defined]


def test_pods_that_never_end_are_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their machine may be away."""
    monkeypatch.setattr(watching, "LEAVING", 0.1)
    watch = watch_graphs(monkeypatch, [talking("/talker"), talking("/talker")], [[ENDING]])
    found = watch.find_differences()
    assert found is not None
    assert found.worse == ()


def test_a_long_report_is_cut() -> None:
    """A master that is gone takes everything with it."""
    lines = tuple(f"line {number}" for number in range(50))
    assert watching.limit(lines[:20]) == lines[:20]
    cut = watching.limit(lines)
    assert cut == (*lines[:19], "and 31 more; `rigel graph` shows all")


def test_what_runs_once_is_not_missed_afterwards() -> None:
    """A task that an earlier deploy had given up on may have run before this update."""
    ref = ObjectRef("batch/v1", "Job", "robots", "spawn")
    plan = Plan(RELEASE, (Step("keep", ref, {"kind": "Job"}, {"kind": "Job"}),))
    graph = RosGraph((GraphNode("/spawn", workload="spawn"), GraphNode("/arm", workload="arm")))
    assert watching.list_removed(plan, graph) == {"/spawn"}


def run_node(image: str, *, hands_over: bool = True, replicas: int = 1) -> dict[str, Any]:
    """Return a Deployment."""
    env = [{"name": "RIGEL_K8S_PEERS", "value": "arm-pods"}] if hands_over else []
    pod = {"spec": {"containers": [{"image": image, "env": env}]}}
    return {"kind": "Deployment", "spec": {"replicas": replicas, "template": pod}}


@pytest.mark.parametrize(
    ("action", "live", "result", "works"),
    [
        ("change", run_node("a"), run_node("b"), True),
        ("change", run_node("a", hands_over=False), run_node("b"), True),
        ("change", run_node("a"), run_node("b", hands_over=False), False),
        ("change", run_node("a"), run_node("b", replicas=0), False),
        ("create", None, run_node("b", hands_over=False), True),
        ("prune", run_node("a"), None, False),
    ],
    ids=["hands over", "begins to", "ends first", "has fewer pods", "is new", "is removed"],
)
def test_old_nodes_are_read_beside_new_ones_only_if_they_work_on(
    action: Any, live: Any, result: Any, *, works: bool
) -> None:
    ref = ObjectRef("apps/v1", "Deployment", "robots", "arm")
    step = Step(action, ref, result or live, live, result)
    assert watching.works_on(step) is works
    replaced = attrs.evolve(step, replaces=True)  # deleted first, since it cannot be changed
    assert watching.works_on(replaced) is (action == "create")


def test_an_error_of_the_reading_beside_is_raised_where_it_is_compared(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It would be printed by a thread otherwise, and the update would pass as one without ROS."""
    watch = watch_graphs(monkeypatch, [RosGraph()], [[]])
    monkeypatch.setattr(watching, "find_last_good", lambda *_: Mock(number=1))
    monkeypatch.setattr(watching, "uses_ros", lambda _: True)
    monkeypatch.setattr(reading, "list_objects", lambda *_: None)
    monkeypatch.setattr(watching, "read_graph", Mock(side_effect=[ZeroDivisionError, RosGraph()]))
    ref = ObjectRef("apps/v1", "Deployment", "robots", "arm")
    watch.begin(Plan(RELEASE, (Step("change", ref, {}, run_node("a"), run_node("b")),)))
    with pytest.raises(ZeroDivisionError):
        watch.find_differences()

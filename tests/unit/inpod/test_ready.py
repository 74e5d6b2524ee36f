"""What the readiness probe says of a pod, with a master and nodes of threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import pytest
from tests.support.rosgraph import Node, RosGraph, ros_graph


class Pod:
    """The probes of one pod, one after the other; `ports` are its own processes' by their port."""

    def __init__(self, ready: ModuleType, graph: RosGraph) -> None:
        self.ready, self.graph = ready, graph
        self.ports: dict[int, int | None] = {}

    def runs(self, node: Node, pid: int = 7) -> Node:
        """Let a node's process be one of this pod."""
        self.ports[node.port] = pid
        return node

    def crash(self, node: Node) -> None:
        """A node's process is gone without a word."""
        del self.ports[node.port]
        node.close()

    def probe(self, name: str | None = None) -> str:
        """Return the line of one look, as the probe prints it."""
        try:
            return str(self.ready.look_node(name, {}))
        except self.ready.NotReady as why:
            return str(why)


@pytest.fixture
def graph() -> Iterator[RosGraph]:
    with ros_graph() as found:
        yield found


@pytest.fixture
def pod(
    graph: RosGraph,
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> Iterator[Pod]:
    monkeypatch.setenv("ROS_MASTER_URI", graph.master.uri)
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    ready, memory = script("ready"), script("memory")
    monkeypatch.setattr(memory, "FILES", (str(tmp_path / "kept"),))
    found = Pod(ready, graph)

    class Listeners:
        def __init__(self) -> None:
            self.pids = dict(found.ports)

    monkeypatch.setattr(ready, "Listeners", Listeners)
    monkeypatch.setattr(ready, "command", lambda pid: f"program {pid}")
    talks = []

    class Api(ready.Api):  # type: ignore[misc, name-defined]
        """The probe leaves its connections to the end of its process."""

        def __init__(self, *words: object) -> None:
            super().__init__(*words)
            talks.append(self)

    monkeypatch.setattr(ready, "Api", Api)
    yield found
    for talk in talks:
        talk.close()


def test_a_registered_node_that_answers_is_ready(pod: Pod, graph: RosGraph):
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert pod.probe() == "ready: /talker"
    assert pod.probe() == "ready: /talker", "what the first probe kept serves the second"


def test_a_process_that_has_not_registered_is_not_ready(pod: Pod, graph: RosGraph):
    pod.runs(graph.program(), pid=12)
    line = pod.probe()
    assert line.startswith("no ROS node of this pod is registered at 127.0.0.1 with the ROS master")
    assert "12 program 12" in line


def test_nothing_that_listens_is_not_ready(pod: Pod):
    assert pod.probe().startswith("no process of this container listens yet")


def test_another_pods_node_at_the_same_address_is_not_ours(pod: Pod, graph: RosGraph):
    """With host networking the address alone tells nothing."""
    graph.node("/other", ["/chatter"])
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert pod.probe() == "ready: /talker"


def test_a_node_that_does_not_answer_is_not_ready(
    pod: Pod, graph: RosGraph, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(pod.ready, "ANSWER", 0.1)
    uri = graph.silent()
    graph.master.add("/talker", uri, ["/chatter"])
    pod.ports[int(uri.rstrip("/").rpartition(":")[2])] = 7
    started = time.monotonic()
    assert "is registered but does not answer: timed out" in pod.probe()
    assert time.monotonic() - started < 2


def test_a_crashed_node_keeps_its_pod_unready(pod: Pod, graph: RosGraph):
    """It is still registered with its topics: nobody has taken leave."""
    pod.runs(graph.node("/one", ["/chatter"]), pid=7)
    two = pod.runs(graph.node("/two", ["/chatter"]), pid=8)
    assert pod.probe() == "ready: /one, /two"
    pod.crash(two)
    assert "/two (http://127.0.0.1:" in pod.probe()
    assert "has crashed" in pod.probe()


def test_a_node_that_took_leave_has_not_crashed(pod: Pod, graph: RosGraph):
    """`rosnode kill` of one of several: the master may still return its name, without topics."""
    pod.runs(graph.node("/one", ["/chatter"]), pid=7)
    two = pod.runs(graph.node("/two", ["/chatter"]), pid=8)
    assert pod.probe() == "ready: /one, /two"
    graph.master.drop("/two")
    pod.crash(two)
    assert pod.probe() == "ready: /one"


def test_the_only_node_that_took_leave_leaves_an_unready_pod(pod: Pod, graph: RosGraph):
    node = pod.runs(graph.node("/talker", ["/chatter"]))
    pod.runs(graph.program(), pid=9)
    assert pod.probe() == "ready: /talker"
    graph.master.drop("/talker")
    pod.crash(node)
    line = pod.probe()
    assert line.startswith("no ROS node of this pod is registered at 127.0.0.1")


def test_a_visitors_node_neither_makes_ready_nor_unready(pod: Pod, graph: RosGraph):
    """A tool that `rigel exec` brought in and that was killed stays registered for ever."""
    tool = graph.node("/rostopic_533_1", ["/rosout"])  # its port is none of the pod's
    pod.runs(graph.program(), pid=9)
    assert pod.probe().startswith("no ROS node of this pod is registered")
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert pod.probe() == "ready: /talker"
    tool.close()
    assert pod.probe() == "ready: /talker"

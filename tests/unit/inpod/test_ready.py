"""What the readiness probe says of a pod, with a master and nodes of threads."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from tests.support.rosgraph import Node, RosGraph, ros_graph


class Pod:
    """The probes of one pod, one after the other; `ports` are its own processes' by their port."""

    def __init__(self, ready: ModuleType, memory: ModuleType) -> None:
        self.ready, self.memory = ready, memory
        self.ports: dict[int, int | None] = {}

    def runs(self, node: Node, pid: int = 7) -> Node:
        """Let a node's process be one of this pod."""
        self.ports[node.port] = pid
        return node

    def crash(self, node: Node) -> None:
        """A node's process is gone without a word."""
        del self.ports[node.port]
        node.close()

    def fail(self, why: str) -> None:
        """Say that the pod is not ready."""
        raise self.ready.NotReady(why)

    def probe(self, manager: str | None = None) -> str:
        """Return the line of one look, as the probe prints it."""
        try:
            return str(self.ready.look_node({}, manager))
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
    found = Pod(ready, memory)

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
    uri = graph.serve_silence()
    graph.master.add("/talker", uri, ["/chatter"])
    pod.ports[int(uri.rstrip("/").rpartition(":")[2])] = 7
    line, _, seconds = pod.probe().partition(" after ")
    assert line.endswith("is registered but does not answer: timed out")
    assert 0.1 <= float(seconds.split()[0]) < pod.ready.LOOK / 2


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


def test_an_orphan_of_a_restarted_master_says_so(pod: Pod, graph: RosGraph):
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert pod.probe() == "ready: /talker"
    graph.master.drop("/talker")
    del graph.master.nodes["/talker"]
    graph.master.parameters["/run_id"] = "run-2"
    assert pod.probe().rstrip().endswith("restart this pod [orphan]")
    assert "restart this pod" in pod.probe()


def test_a_node_that_told_a_new_master_only_half_is_an_orphan(pod: Pod, graph: RosGraph):
    node = pod.runs(graph.node("/talker", ["/chatter", "/early"]))
    assert pod.probe() == "ready: /talker"
    graph.master.parameters["/run_id"] = "run-2"
    del graph.master.publishers["/early"]
    assert "does not have its /early" in pod.probe()
    node.publishes.remove("/early")
    assert pod.probe() == "ready: /talker"


def test_a_master_that_remembers_has_no_orphans(pod: Pod, graph: RosGraph):
    pod.runs(graph.node("/talker", ["/chatter"], subscribes=["/clock"]))
    assert pod.probe() == "ready: /talker"
    graph.master.parameters["/run_id"] = "run-2"
    assert pod.probe() == "ready: /talker"


def test_a_name_that_another_pods_node_has_taken(pod: Pod, graph: RosGraph):
    """The master has it elsewhere, while the old process lives on."""
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert pod.probe() == "ready: /talker"
    graph.master.nodes["/talker"] = graph.program().uri
    assert "has lost its name to another node" in pod.probe()


def test_a_node_that_its_shell_started_again_is_ready_at_its_new_port(pod: Pod, graph: RosGraph):
    old = pod.runs(graph.node("/talker", ["/chatter"]))
    assert pod.probe() == "ready: /talker"
    pod.crash(old)
    again = pod.runs(graph.program(["/chatter"]), pid=9)
    graph.master.nodes["/talker"] = again.uri
    assert pod.probe() == "ready: /talker"


def test_the_rosout_of_an_images_own_roscore_makes_nothing_ready(pod: Pod, graph: RosGraph):
    pod.runs(graph.node("/rosout", ["/rosout_agg"]))
    assert pod.probe().startswith("no ROS node of this pod is registered")


def test_nodes_that_come_later_are_found(pod: Pod, graph: RosGraph):
    """The master is searched again while a process listens that has no node."""
    pod.runs(graph.node("/one", ["/chatter"]), pid=7)
    late = pod.runs(graph.program(["/chatter"]), pid=8)
    assert pod.probe() == "ready: /one"
    graph.master.add("/late", late.uri, ["/chatter"])
    assert pod.probe() == "ready: /late, /one"


def test_a_process_without_a_node_is_not_searched_for_for_ever(pod: Pod, graph: RosGraph):
    """A web server in the container must not cost the master its whole state with each probe."""
    asked = []
    real = graph.master.getSystemState
    graph.master.getSystemState = lambda caller: asked.append(1) or real(caller)  # type: ignore
    pod.runs(graph.node("/one", ["/chatter"]), pid=7)
    pod.runs(graph.program(), pid=8)
    for _ in range(pod.ready.SEARCHES + 3):
        assert pod.probe() == "ready: /one"
    assert len(asked) == pod.ready.SEARCHES


def test_a_master_that_is_away_names_the_pods_nodes(pod: Pod, graph: RosGraph):
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert pod.probe() == "ready: /talker"
    graph.master.close()
    line = pod.probe()
    assert f"the ROS master at {graph.master.uri} cannot be reached: Connection refused" in line
    assert line.endswith("(nodes of this pod: /talker)")


def test_without_a_master_uri(pod: Pod, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("ROS_MASTER_URI")
    assert pod.probe() == "ROS_MASTER_URI is not set in this container"
    monkeypatch.setenv("ROS_MASTER_URI", "ros-master")
    pod.ports[1] = 1
    assert pod.probe().startswith("ROS_MASTER_URI: 'ros-master' is not http://HOST:PORT")


def test_a_memory_of_another_life_is_worth_nothing(
    pod: Pod, graph: RosGraph, monkeypatch: pytest.MonkeyPatch
):
    """After a restart of the container the old node has ended with it, not crashed."""
    node = pod.runs(graph.node("/old", ["/chatter"]))
    assert pod.probe() == "ready: /old"
    pod.crash(node)
    monkeypatch.setattr(pod.memory.container, "started", lambda: "another life")
    pod.runs(graph.node("/new", ["/chatter"]))
    assert pod.probe() == "ready: /new"


def test_a_container_that_can_write_nowhere_is_probed_all_the_same(
    pod: Pod, graph: RosGraph, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(pod.memory, "FILES", ("/proc/nowhere",))
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert [pod.probe(), pod.probe()] == ["ready: /talker"] * 2


# -- the master's own probe --


def test_a_master_that_answers_is_ready(pod: Pod, graph: RosGraph):
    line = pod.ready.look_master(starting=False)
    assert line == f"ready: ROS master at port {graph.master.port}"
    graph.master.close()
    with pytest.raises(pod.ready.NotReady, match="does not answer: Connection refused"):
        pod.ready.look_master(starting=False)


def test_a_starting_roscore_has_its_parameters_first(
    pod: Pod, graph: RosGraph, monkeypatch: pytest.MonkeyPatch
):
    """A node may ask for /rosversion at once; a bare rosmaster sets none."""
    assert pod.ready.look_master(starting=True), "a bare rosmaster"
    monkeypatch.setattr(pod.ready, "roscore_runs", lambda: True)
    with pytest.raises(pod.ready.NotReady, match="has not set /rosversion yet"):
        pod.ready.look_master(starting=True)
    assert pod.ready.look_master(starting=False), "once it runs nothing of it is asked for"
    graph.master.parameters["/rosversion"] = "1.16.0"
    assert pod.ready.look_master(starting=True)


# -- the command line --


@pytest.fixture
def ended(pod: Pod, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[int, str]]:
    """Run the script with words; what it ended with."""

    class Ended(BaseException):
        pass

    def finish(code: int, line: str) -> None:
        raise Ended(code, line)

    def run(*words: str) -> tuple[int, str]:
        with pytest.raises(Ended) as raised:
            pod.ready.main(words)
        return raised.value.args  # type: ignore[return-value]

    monkeypatch.setattr(pod.ready, "finish", finish)
    monkeypatch.setattr(pod.ready, "start_new_thread", lambda *_: None)
    return run


def test_exit_codes(pod: Pod, graph: RosGraph, ended: Callable[..., tuple[int, str]]):
    assert ended("node")[0] == 1
    assert ended("master") == (0, f"ready: ROS master at port {graph.master.port}")
    pod.runs(graph.node("/talker", ["/chatter"]))
    assert ended("node") == (0, "ready: /talker")


def test_a_manager_is_ready_once_its_nodelets_are_loaded(
    pod: Pod,
    graph: RosGraph,
    script: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
):
    """What keeps one from being loaded is the line, as long as the manager itself is in order."""
    progress = script("progress")
    monkeypatch.setattr(progress, "FILES", (str(tmp_path / "progress"),))
    pod.runs(graph.node("/manager", ["/rosout"]))
    assert pod.probe(manager="/manager") == "nodelets.py has not started yet for /manager"
    progress.Progress("failed", "/manager cannot load /wheel", pid=os.getpid()).save()
    assert pod.probe(manager="/manager") == "/manager cannot load /wheel"
    assert pod.probe() == "ready: /manager"
    progress.Progress("done", "/manager has loaded /wheel").save()
    assert pod.probe(manager="/manager") == "ready: /manager, /manager has loaded /wheel"


@pytest.mark.parametrize(
    "words", [(), ("nod",), ("node", "--wait"), ("master", "--components", "/a")]
)
def test_wrong_arguments(ended: Callable[..., tuple[int, str]], words: tuple[str, ...]):
    assert ended(*words)[0] == 2


def test_waiting_ends_with_the_last_reason(
    pod: Pod, ended: Callable[..., tuple[int, str]], monkeypatch: pytest.MonkeyPatch
):
    clock = [0.0]

    def sleep(seconds: float) -> None:
        clock[0] += seconds

    monkeypatch.setattr(pod.ready, "time", SimpleNamespace(time=lambda: clock[0], sleep=sleep))
    looks: list[int] = []
    monkeypatch.setattr(pod.ready, "look_node", lambda *_: looks.append(1) or pod.fail("not yet"))
    assert ended("node", "--wait", "5") == (1, "not yet")
    assert 3 < clock[0] < 5
    assert len(looks) > pod.ready.CALM, "it looks again and again"


def test_a_look_that_hangs_ends_with_a_word(pod: Pod, monkeypatch: pytest.MonkeyPatch):
    """A name service that does not answer knows no deadline of ours."""
    told: list[tuple[int, str]] = []
    monkeypatch.setattr(pod.ready, "finish", lambda *words: told.append(words))
    pod.ready.watch(0.01, [])
    pod.ready.watch(0.01, ["the last reason"])
    assert told == [
        (1, "timed out after 0.0 s; is the cluster's DNS in order?"),
        (1, "the last reason"),
    ]

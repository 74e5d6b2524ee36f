"""Programs that follow a topic in a pod: what they print, when they end, where they run."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections import deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any, BinaryIO

import pytest

from rigel_graph import hz, tools
from rigel_graph.cli.topics import write
from rigel_graph.commands import live as running
from rigel_graph.commands import params
from rigel_graph.tools import ROS1, ROS2, CannotRun, Inbox
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_inpod.sent import read_module
from rigel_k8s.commands.pods import Pod
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, RigelK8sError, UserError
from rigel_k8s.release.types import ReleaseId
from tests.support.notes import SECOND, answer, process, publisher, subscription
from tests.support.pythons import find_python

from .local import POD

pytestmark = pytest.mark.programs

#: As much of rospy as the program uses; it publishes COUNT messages, and waits for its end.
ROSPY = """
import threading, time
class Stamp(object):
    secs, nsecs = 3, 4
class Inner(object):
    __slots__, _slot_types, _type = ["x"], ["float64"], "t/Inner"
    def __init__(self):
        self.x = 1.5
class Message(object):
    __slots__ = ["stamp", "raw", "data", "list"]
    _slot_types, _type = ["time", "uint8[]", "string", "t/Inner[]"], "t/Message"
    def __init__(self, data="x"):
        self.stamp, self.raw, self.data = Stamp(), b"\\x01\\xff\\x02", data
        self.list = [Inner()]
AnyMsg = Message
class Subscriber(object):
    def __init__(self, topic, kind, receive, tcp_nodelay):
        for number in range(COUNT):
            receive(kind("%s %d" % (topic, number)))
    def get_num_connections(self):
        return 1
def init_node(name, **_):
    assert name.startswith("_rigel")
def signal_shutdown(why):
    pass
"""
ROSLIB = """
import rospy
def get_message_class(name):
    return rospy.Message if name == "t/Message" else None
"""
REQUEST = {"do": "echo", "topic": "/a", "type": "t/Message", "field": [], "most": 2, "count": 2}


class Here:
    """A cluster with one pod, this machine; its image has a rospy of the test."""

    def __init__(self, folder: Path, python: str, count: int = 2) -> None:
        self.python = python
        self.env = {"PATH": "/usr/bin:/bin", "PYTHONPATH": str(folder)}
        self.processes: list[subprocess.Popen[bytes]] = []
        self.ended = threading.Event()
        (folder / "roslib").mkdir()
        (folder / "roslib" / "__init__.py").write_text("")
        (folder / "roslib" / "message.py").write_text(ROSLIB)
        (folder / "rospy.py").write_text(ROSPY.replace("COUNT", str(count)))

    def exec(
        self, _: str, __: str, command: list[str], *, stdin: BinaryIO, stdout: Any, **___: Any
    ) -> int:
        """Run what exec.sh and the choice of a Python lead to."""
        words = [self.python, "-u", "-B", "-c", *command[5:]]
        process = subprocess.Popen(words, stdin=stdin, stdout=subprocess.PIPE, env=self.env)
        self.processes.append(process)
        assert process.stdout is not None
        for line in process.stdout:
            stdout.write(line)
        process.stdout.close()
        code = process.wait()
        self.ended.set()
        return code


@pytest.fixture(params=["2.7", "3"])
def python(request: pytest.FixtureRequest) -> str:
    return sys.executable if request.param == "3" else find_python(request.param)


def test_messages_of_ros_1_are_plain_and_shortened(python: str, tmp_path: Path) -> None:
    """Bytes are numbers, times have two parts, and what is longer than `most` ends with dots."""
    cluster: Any = Here(tmp_path, python)
    first, second = ROS1.run(cluster, POD, REQUEST)
    assert first["message"] == {
        "stamp": {"secs": 3, "nsecs": 4},
        "raw": [1, 255, "..."],
        "data": "/a...",
        "list": [{"x": 1.5}],
    }
    assert (first["shortened"], second["dropped"]) == (True, 0)
    found = list(ROS1.run(cluster, POD, {**REQUEST, "field": ["data"], "most": None}))
    assert [one["message"] for one in found] == ["/a 0", "/a 1"]


def test_a_program_ends_with_its_caller(python: str, tmp_path: Path) -> None:
    """It waits for messages, and its input is closed: by the caller, or by its death."""
    cluster: Any = Here(tmp_path, python)
    answers = ROS1.run(cluster, POD, {**REQUEST, "count": None})
    next(answers)
    assert cluster.processes[0].poll() is None
    answers.close()
    assert cluster.ended.wait(20)


def test_messages_that_wait_are_dropped_and_counted(tmp_path: Path) -> None:
    """Of 500 that come at once the newest are printed."""
    cluster: Any = Here(tmp_path, sys.executable, count=500)
    answers = ROS1.run(cluster, POD, {**REQUEST, "most": None, "count": None})
    first = next(answers)
    assert first["dropped"] >= 400
    assert first["message"]["data"] == f"/a {first['dropped']}"
    answers.close()


@pytest.mark.parametrize(
    ("tool", "request_", "word"),
    [
        (ROS2, REQUEST, "no-library"),
        (ROS1, {**REQUEST, "type": "t/Other"}, "no-type"),
        (ROS1, {**REQUEST, "field": ["list", "x"]}, "no-field"),
    ],
    ids=["library", "type", "field"],
)
def test_what_cannot_be_done_is_a_word(tool: Any, request_: Any, word: str, tmp_path: Path) -> None:
    cluster: Any = Here(tmp_path, sys.executable)
    with pytest.raises(CannotRun) as caught:
        list(tool.run(cluster, POD, request_))
    assert caught.value.word == word


def test_a_slow_reader_gets_the_newest() -> None:
    inbox = Inbox(2)
    inbox.write(b"1\n2\n3\n4")
    inbox.write(b"4\n")
    inbox.end(None)
    assert (list(inbox.read()), inbox.dropped) == ([b"3", b"44"], 2)


def test_a_message_that_does_not_come_ends_the_program(tmp_path: Path) -> None:
    """What came before is yielded; the hint has a way to wait."""
    inbox = Inbox(None)
    inbox.write(b"1\n")
    lines = inbox.read(0.01)
    assert next(lines) == b"1"
    cluster: Any = Here(tmp_path, sys.executable, count=0)
    for waiting in (lines, ROS1.run(cluster, POD, {**REQUEST, "within": 0.01})):
        with pytest.raises(ClusterError, match=r"no message came within 0\.01 s") as caught:
            next(waiting)
        assert "rigel topic echo" in (caught.value.hint or "")
    assert cluster.ended.wait(20)


def test_lines_that_are_no_answers_are_left_out() -> None:
    assert [tools.parse(line) for line in (b"a log", b"3", b'{"a": 1}')] == [{}, {}, {"a": 1}]


def load(name: str) -> Any:
    """Return a module as a pod has it."""
    found: dict[str, Any] = {"__name__": name}
    text = read_module(f"rigel_inpod.sent.{name}").replace("import lines\n", "")
    exec(compile(text, name, "exec"), found)
    return SimpleNamespace(**found) if name == "lines" else found


@pytest.mark.parametrize(
    ("publishers", "chosen"),
    [
        ([], (False, False)),
        ([(True, True)], (True, True)),
        ([(True, True), (True, False)], (True, False)),
        ([(True, True), (False, True)], (False, True)),
    ],
)
def test_a_subscription_fits_all_publishers(publishers: Any, chosen: Any) -> None:
    """Best effort if one is, latched only if all are; without any what every one can serve."""
    assert load("ros2_tools")["choose_qos"](publishers) == chosen


@pytest.mark.parametrize(
    ("value", "declared", "kind"),
    [
        (3, 3, 3),
        (3, 2, 2),
        (True, 3, 1),
        ("a", 4, 4),
        ([], 7, 7),
        ([], 0, 9),
        ([1, 2], 8, 8),
        ([1, 2.5], 7, 8),
        ([1, 2], 0, 7),
        ([True], 0, 6),
        (["a"], 0, 9),
    ],
)
def test_a_value_gets_the_type_that_the_node_has(value: Any, declared: int, kind: int) -> None:
    """A whole number is a double where the node has one."""
    assert load("ros2_tools")["choose_type"](value, declared) == kind


@pytest.mark.parametrize("value", [{"a": 1}, [1, "a"], None])
def test_a_value_that_no_parameter_has(value: Any) -> None:
    found, lines = load("ros2_tools"), load("lines")
    found["choose_type"].__globals__["lines"] = lines
    with pytest.raises(lines.Failure) as caught:
        found["choose_type"](value, 0)
    assert caught.value.word == "no-value"


def test_messages_are_written_as_ros_2_does() -> None:
    message = {"b": [1.5, "..."], "a": {"x": float("nan")}}
    assert write(message, "yaml") == "b:\n- 1.5\n- '...'\na:\n  x: .nan\n---\n"
    assert write(message, "json") == '{"b": [1.5, "..."], "a": {"x": null}}\n'
    assert write("a\x1b[2J", "yaml") == '"a\\e[2J"\n---\n'
    assert write(3, "yaml") == "3\n---\n"
    assert write({"a": "shortened..."}, "yaml") == "a: shortened...\n---\n"
    assert write("shortened...", "yaml") == "shortened...\n---\n"


def pod(workload: str, **more: Any) -> Pod:
    known = {"scripts": True, "phase": "Running", "ready": True, **more}
    return Pod(f"{workload}-1", "robots", workload, frozenset({workload}), "c", created="", **known)


def test_a_publishers_pod_comes_first() -> None:
    """Then ready ones, each node once; not what watches nodes, or does not run."""
    pods = [
        pod("ros-master"),
        pod("exporter", helper=True),
        pod("gone", phase="Terminating"),
        pod("bare", scripts=False),
        pod("late", ready=False),
        pod("listener"),
        pod("talker", ready=False),
    ]
    found = running.order_pods(pods, [("talker-1", "talker")])
    assert [one.workload for one in found] == ["talker", "listener", "ros-master", "late"]


class Program:
    """A program whose answers depend on the pod: a word, or messages."""

    library = "rclpy"

    def __init__(self, **answers: str) -> None:
        self.answers, self.pods = answers, list[str]()

    def run(self, _: Any, pod: Pod, request: Any) -> Any:
        self.pods.append(pod.workload)
        word = self.answers.get(pod.workload)
        if word:
            raise CannotRun(pod.name, word, f"text of {word}")
        yield {"message": 1}


def live(monkeypatch: pytest.MonkeyPatch, **answers: str) -> tuple[running.Live, Program]:
    program: Any = Program(**answers)
    monkeypatch.setattr(running, "ROS2", program)
    nodes = [
        GraphNode(f"/{name}", pod=f"{name}-1", workload=name) for name in ("talker", "listener")
    ]
    nodes += [GraphNode(f"/{name}", pod="many-1", workload="many") for name in ("a", "b")]
    topics = (GraphTopic("/chatter", "std_msgs/msg/String", ("/talker",)), GraphTopic("/rosout"))
    cluster: Any = None
    release = Release(cluster, ReleaseId("robots", "explorer"))
    pods = [pod("listener"), pod("many"), pod("talker")]
    return running.Live(release, pods, RosGraph(tuple(nodes), topics), "2"), program


def test_another_pod_is_tried_if_an_image_lacks_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    found, program = live(monkeypatch, talker="no-library")
    assert list(found.ask({}, ["/talker"], None, "x")) == [{"message": 1}]
    assert program.pods == ["talker", "listener"]


@pytest.mark.parametrize(
    ("word", "error", "message"),
    [
        ("no-library", ClusterError, r"image of the pod talker-1 .* rclpy \(text of no-library\)"),
        (
            "no-type",
            ClusterError,
            "image of the pod talker-1 does not have the type text of no-typ",
        ),
        ("no-field", UserError, "^text of no-field$"),
        ("no-service", ClusterError, "the node text of no-service"),
    ],
)
def test_what_no_pod_can_do(
    word: str, error: type[RigelK8sError], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`--node` leaves no other pod; an image that lacks something has a way out."""
    found, _ = live(monkeypatch, talker=word)
    with pytest.raises(error, match=message) as caught:
        list(found.ask({}, ["/talker"], "talker", "ros2 topic echo /x"))
    if word in running.OF_IMAGE:
        assert "--node" in (caught.value.hint or "")
        assert "rigel join -- ros2 topic echo /x" in (caught.value.hint or "")


def test_unknown_names_are_usage_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = live(monkeypatch)
    assert found.find_topic("chatter").name == "/chatter"
    assert found.find_node("talker").name == found.find_node("/talker").name == "/talker"
    for name, text in (("/chater", 'did you mean "/chatter"'), ("/rosuot", "no node has a topic")):
        with pytest.raises(UserError, match=text):
            found.find_topic(name)
    for name, text in (("/talkr", '"/talker"'), ("talkr", '"talker"'), ("many", "2 nodes")):
        with pytest.raises(UserError, match=text):
            found.find_node(name)
    with pytest.raises(UserError, match='no parameter "sped", did you mean "speed"'):
        params.check_names("/talker", ["sped"], ["speed"])


def test_parameters_of_ros_1_are_a_tree() -> None:
    tree = {"speed": 1, "pid": {"p": 2, "empty": {}}}
    assert list(params.flatten(tree)) == [("speed", 1), ("pid/p", 2), ("pid/empty", {})]
    assert params.full_name("/talker", "speed") == "/talker/speed"
    assert params.full_name("/talker", "/rosdistro") == "/rosdistro"


def test_two_readings_of_ros_1_are_a_rate() -> None:
    """A node that was replaced between them counts from the next one on."""
    stats = [[["/scan", [["1", 100, 10, True]]]], []]
    later = [[["/scan", [["1", 300, 30, True]]]], []]
    old = {name: {"name": name, "uri": "u", "at": 1.0, "stats": [stats]} for name in ("/a", "/b")}
    new = {name: {"name": name, "uri": "u", "at": 3.0, "stats": [later]} for name in ("/a", "/b")}
    new["/b"]["uri"] = "other"
    (one,) = hz.pair(old, new)
    assert (one["name"], one["seconds"]) == ("/a", 2.0)
    assert hz.ros1.measure_rates([one]) == {"/scan": 10.0}


def notes(seconds: int, sent: int, taken: int) -> dict[str, Any]:
    """What a pod has noted at a moment."""
    at: dict[str, Any] = {"last": (seconds + 99) * SECOND, "longest": SECOND // 2, "matched": 1}
    ends = publisher("/a", "/scan", sent, **at), subscription("/a", "/scan", taken, **at)
    return answer(process("/a", parts=ends), now=at["last"])


def test_a_beat_of_ros_2_is_what_its_publishers_count() -> None:
    """The longest gap, the partners, and what subscribers have not taken."""
    readings = deque([{"p": notes(0, 0, 0)}, {"p": notes(1, 20, 5)}, {"p": notes(2, 40, 10)}])
    assert hz.read_beat(readings, "/scan") == hz.Beat(20.0, 0.5, 1, 15.0)
    assert hz.read_beat(deque([{}, {"p": notes(1, 20, 20)}]), "/scan").rate == 0

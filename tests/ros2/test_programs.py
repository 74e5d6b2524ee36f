"""Processes with the layer that are more than a node: containers, several contexts, children."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from rigel_inpod.rmw_notes import STOP, WORK, read_all
from rigel_rmw import libraries
from tests.support.layer import Node
from tests.support.until import until

pytestmark = pytest.mark.cluster

#: Two contexts, each with a node and a thread; each line of its input ends the second one, and
#: begins it again.
CONTEXTS = """
import sys, threading, rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from std_msgs.msg import Int64

def begin(name):
    context = rclpy.Context()
    context.init()
    node = rclpy.create_node(name, context=context)
    out = node.create_publisher(Int64, name + "/tick", 10)
    node.create_timer(0.05, lambda: out.publish(Int64(data=1)))
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    def spin():
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
    thread = threading.Thread(target=spin, daemon=True)
    thread.start()
    return context, node, executor, thread

first, second = begin("first"), begin("second")
for line in sys.stdin:
    context, node, executor, thread = second
    executor.shutdown()
    thread.join()
    node.destroy_node()
    context.shutdown()
    second = begin("second")
    print("done", flush=True)
"""


Start = Callable[..., Node]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Starts a program with the layer, which is driven by lines."""
    found = libraries().get(f"rmw-{os.uname().machine}.so")
    if found is None:
        pytest.skip("the layer is not built: it needs ziglang")
    library, notes, nodes = tmp_path / "layer.so", tmp_path / "notes", []
    library.write_bytes(found)
    notes.mkdir()
    env = {"LD_PRELOAD": str(library), "RIGEL_RMW": str(notes), "ROS_LOCALHOST_ONLY": "1"}
    env |= {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    env |= {"ROS_DOMAIN_ID": os.environ.get("ROS_DOMAIN_ID", "66")}

    def start(*command: str) -> Node:
        words = ["env", *(f"{key}={value}" for key, value in env.items()), *command]
        pipe = subprocess.PIPE
        process = subprocess.Popen(
            words, stdin=pipe, stdout=pipe, text=True, start_new_session=True
        )
        nodes.append(Node(process, notes))
        return nodes[-1]

    yield start
    for node in nodes:
        os.killpg(node.process.pid, signal.SIGKILL)  # its children, too
        node.process.communicate()


def names(node: Node, kind: str = "node") -> list[str]:
    """The nodes, or other entities, of all of its processes."""
    found = (one for p in node.notes.processes() for one in p.entities)
    return sorted(one.name for one in found if one.kind == kind)


def count(node: Node, topic: str, of: str = "count") -> int:
    """How often a topic was published, or not."""
    return int(str(node.entity(topic)[of]))


def check_both_talk(node: Node, *topics: str) -> None:
    """Both publish when the process works, and none does when it is stopped."""
    before = [count(node, topic) for topic in topics]
    until(lambda: all(count(node, t) > b for t, b in zip(topics, before, strict=True)), "both talk")
    node.notes.set_mode(STOP)
    muted = [count(node, topic, "dropped") for topic in topics]
    until(
        lambda: all(count(node, t, "dropped") > m + 2 for t, m in zip(topics, muted, strict=True)),
        "both are muted",
    )
    at = [count(node, topic) for topic in topics]
    muted = [count(node, topic, "dropped") for topic in topics]
    until(
        lambda: all(count(node, t, "dropped") > m + 2 for t, m in zip(topics, muted, strict=True)),
        "both are muted",
    )
    assert [count(node, topic) for topic in topics] == at
    node.notes.set_mode(WORK)


def test_components_come_and_go(start: Start, program: Callable[[str, str], Path]) -> None:
    """One is unloaded, and its library closed, while another works; a new one obeys the mode."""
    part = str(program("jazzy", "part.so"))
    node = start(str(program("jazzy", "container")), f"{part}=a")
    until(lambda: "/a/tick" in names(node, "publisher"), "first component")
    key = ""
    for _ in range(3):
        assert node.do(f"load {part}=b") == "done"
        assert names(node) == ["/a/part", "/b/part"]
        assert key in ("", node.entity("/b/tick")["key"])
        key = str(node.entity("/b/tick")["key"])
        check_both_talk(node, "/a/tick", "/b/tick")
        assert node.do(f"unload {part}=b") == "done"
        assert names(node) == ["/a/part"]
    assert node.do(f"unload {part}=a") == "done"  # and its library, which no one else has
    assert part not in Path(f"/proc/{node.process.pid}/maps").read_text()
    assert names(node) == []
    assert node.do(f"load {part}=a") == "done"
    check_both_talk(node, "/a/tick", "/a/tick")


def test_contexts_end_and_begin(start: Start, venv: Callable[[str], Path]) -> None:
    """One is shut down while another works; the next one obeys the mode."""
    node = start(str(venv("jazzy") / "bin/python3"), "-c", CONTEXTS)
    topics = {"/first/tick", "/second/tick"}
    until(lambda: topics <= set(names(node, "publisher")), "both contexts")
    for _ in range(2):
        check_both_talk(node, "/first/tick", "/second/tick")
        assert node.do("again") == "done"
        assert names(node) == ["/first", "/second"]
        check_both_talk(node, "/first/tick", "/first/tick")
    until(lambda: len(names(node, "executor")) == 2, "the slots of two threads")


def test_children_have_notes_of_their_own(
    start: Start, program: Callable[[str, str], Path]
) -> None:
    """A program that a node starts beside it, and one that it becomes."""
    other = str(program("jazzy", "part"))
    node = start(str(program("jazzy", "container")), f"{program('jazzy', 'part.so')}=a")
    until(lambda: names(node) == ["/a/part"], "the node")
    assert node.do(f"run {other}") == "done"
    until(lambda: names(node) == ["/a/part", "/part"], "the child's node")
    assert len({p.pid for p in node.notes.processes()}) == 2
    check_both_talk(node, "/a/tick", "/tick")
    assert node.do("run /bin/true") == "done"
    node.send(f"become {other}")
    until(lambda: names(node) == ["/part", "/part"], "the next program's node")
    assert [p.ended for p in read_all(str(node.directory))] == [False, False]

"""The layer in an unmodified node on Fast DDS, in Python and in C: what each mode lets pass."""

from __future__ import annotations

import itertools
import os
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import attrs
import pytest

from rigel_inpod.rmw_notes import FINISH, HOLD, STOP, WAIT, WORK, Notes
from rigel_rmw import libraries
from tests.support.until import until

from .conftest import run

pytestmark = pytest.mark.cluster

#: Echoes what it hears, -1 after two seconds, in a thread of a pool, and ticks and asks meanwhile.
#: ros2_c/part.c does the same.
WORKER = """
import time
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64

rclpy.init()
node = rclpy.create_node("worker")
echo = node.create_publisher(Int64, "echo", 10)
tick = node.create_publisher(Int64, "tick", 10)
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_publisher(Int64, "map", latched).publish(Int64(data=5))


def answer(message):
    print("begins", message.data, flush=True)
    time.sleep(2 if message.data < 0 else 0)
    echo.publish(message)


group = ReentrantCallbackGroup()
node.create_subscription(Int64, "in", answer, 10, callback_group=group)
node.create_service(GetParameters, "ask", lambda request, response: response)
peer = node.create_client(GetParameters, "peer", callback_group=group)
asked = []


def turn():
    tick.publish(Int64(data=1))
    if peer.service_is_ready() and all(one.done() for one in asked):
        asked[:] = [peer.call_async(GetParameters.Request())]


node.create_timer(0.05, turn, callback_group=group)
rclpy.spin(node, MultiThreadedExecutor(3))
"""

#: Prints what it hears and is answered, publishes the numbers of its input, and asks with them.
HEARER = """
import sys
import threading
import time
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Int64

rclpy.init()
node = rclpy.create_node("hearer")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
for name, qos in (("echo", 10), ("tick", 10), ("map", latched)):
    show = lambda message, name=name: print(name, message.data, flush=True)
    node.create_subscription(Int64, name, show, qos)
out = node.create_publisher(Int64, "in", 10)
ask = node.create_client(GetParameters, "ask")
node.create_service(GetParameters, "peer", lambda request, response: response)
threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
for line in sys.stdin:
    while not (out.get_subscription_count() and ask.service_is_ready()):
        time.sleep(0.05)  # the worker may have found this one earlier
    out.publish(Int64(data=int(line)))
    show = lambda done, number=int(line): print("answer", number, flush=True)
    ask.call_async(GetParameters.Request()).add_done_callback(show)
"""


@attrs.frozen
class Pair:
    """A worker with the layer, and one who hears it and talks to it."""

    notes: Notes
    hearer: subprocess.Popen[bytes]
    folder: Path

    def send(self, number: int) -> None:
        """Let the worker be sent a number, and asked with it."""
        assert self.hearer.stdin
        self.hearer.stdin.write(b"%d\n" % number)
        self.hearer.stdin.flush()

    def heard(self) -> list[str]:
        """What has been heard of the worker."""
        return (self.folder / "hearer.log").read_text().splitlines()

    def ticks(self) -> int:
        """How many ticks were heard."""
        return self.heard().count("tick 1")

    def begun(self) -> list[str]:
        """What the worker's callback has begun with."""
        return (self.folder / "worker.log").read_text().splitlines()

    def entity(self, name: str) -> dict[str, int]:
        """What the notes say of a part of the worker; nothing before it exists."""
        parts = [one for process in self.notes.processes() for one in process.entities]
        return next((dict(one._asdict()) for one in parts if one.name == name), {})


_numbers = itertools.count()


@pytest.fixture
def pair(
    venv: Callable[[str], Path],
    program: Callable[[str, str], Path],
    tmp_path: Path,
    distro: str,
    language: str,
) -> Iterator[Pair]:
    """A worker that waits, in a network of its own."""
    found = libraries().get(f"rmw-{os.uname().machine}.so")
    if found is None:
        pytest.skip("the layer is not built: it needs ziglang")
    (tmp_path / "layer.so").write_bytes(found)
    (tmp_path / "notes").mkdir()
    network = f"layer{os.getpid()}n{next(_numbers)}"
    env = {**os.environ, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", "ROS_DOMAIN_ID": "0"}
    layer = {"LD_PRELOAD": str(tmp_path / "layer.so"), "RIGEL_RMW": str(tmp_path / "notes")}
    with ExitStack() as cleanup:
        run("ip", "netns", "add", network)
        cleanup.callback(run, "ip", "netns", "delete", network)
        run("ip", "-n", network, "link", "set", "lo", "up")
        run("ip", "-n", network, "link", "add", "d0", "type", "veth", "peer", "name", "d1")
        run("ip", "-n", network, "address", "add", "10.9.9.1/24", "dev", "d0")
        for end in ("d0", "d1"):
            run("ip", "-n", network, "link", "set", end, "up")

        def start(name: str, *command: str, **more: str) -> subprocess.Popen[bytes]:
            words = ["nsenter", f"--net=/run/netns/{network}", "env"]
            words += [*(f"{key}={value}" for key, value in more.items()), *command]
            log = cleanup.enter_context((tmp_path / f"{name}.log").open("w"))
            started = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=log, env=env)
            cleanup.enter_context(started)
            cleanup.callback(started.kill)
            return started

        python = (str(venv(distro) / "bin/python"), "-c")
        worker = (str(program(distro, "part")),) if language == "C" else (*python, WORKER)
        start("worker", *worker, RIGEL_RMW_MODE="wait", **layer)
        notes = Notes(str(tmp_path / "notes"), WAIT)
        pair = Pair(notes, start("hearer", *python, HEARER), tmp_path)
        until(lambda: notes.fit(), "the worker turns")
        until(lambda: pair.entity("/in").get("matched") == 1, "it is matched")
        until(lambda: pair.entity("/map").get("matched") == 1, "it is matched")
        yield pair


@pytest.mark.parametrize("language", ["Python", "C"])
@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_what_each_mode_lets_pass(pair: Pair, language: str) -> None:
    """From waiting to the end of the hand-over, as docs/ros2-updates.md says."""
    notes = pair.notes
    until(lambda: pair.entity("/echo")["matched"] == 1, "echo is matched")
    until(lambda: pair.entity("/tick")["matched"] == 1, "ticks are matched")

    pair.send(1)
    until(lambda: pair.entity("/in")["dropped"] == 1, "the waiting one drops it")
    until(lambda: pair.entity("/ask")["dropped"] == 1, "it answers no one")
    assert pair.entity("/peer")["count"] == 0
    notes.set_others(["0f" * 12])
    notes.set_known(notes.friends())
    until(lambda: pair.entity("/peer")["answers"] > 3, "it is answered")
    assert pair.entity("/tick")["dropped"] > 0
    assert pair.heard() == pair.begun() == []

    notes.set_mode(HOLD)
    pair.send(2)
    until(lambda: pair.entity("/tick")["dropped"] > 40, "time passes")
    assert pair.begun() == []
    notes.set_mode(WORK)
    until(lambda: "echo 2" in pair.heard(), "what was held is handled")
    until(lambda: pair.ticks() > 3, "it talks")
    assert pair.heard().count("map 5") == 1
    assert pair.begun() == ["begins 2"]
    assert [pair.entity("/in")[of] for of in ("count", "dropped")] == [1, 1]
    until(lambda: "answer 2" in pair.heard(), "a request that was held is answered")
    assert [pair.entity("/ask")[of] for of in ("count", "answers", "dropped")] == [1, 1, 1]
    assert pair.entity("/echo")["count"] == 1
    assert pair.ticks() <= pair.entity("/tick")["count"]  # in this order: both grow
    assert 0 < pair.entity("/in")["age"] < 60e9

    pair.send(-1)
    until(lambda: "begins -1" in pair.begun(), "a callback runs")
    notes.set_mode(FINISH)
    pair.send(3)
    until(lambda: not notes.is_taking(), "it takes nothing more")
    heard = pair.ticks()
    until(lambda: pair.ticks() > heard + 5, "it still talks")
    notes.set_mode(STOP)
    until(lambda: "echo -1" in pair.heard(), "what had begun is finished")
    before, stopped = pair.ticks(), pair.entity("/tick")["dropped"]
    until(lambda: pair.entity("/tick")["dropped"] > stopped + 10, "its timer goes on")
    answers = pair.entity("/peer")["answers"]
    until(lambda: pair.entity("/peer")["answers"] > answers + 3, "it is still answered")
    assert pair.ticks() == before
    assert [line for line in pair.heard() if "answer" in line] == ["answer 2", "answer -1"]
    assert pair.begun() == ["begins 2", "begins -1"]
    assert pair.entity("/in")["dropped"] == 1
    newest = notes.newest()[str(pair.entity("/in")["key"])]
    assert list(newest.values()) == [3]
    turns = [e.count for p in notes.processes() for e in p.entities if e.kind == "executor"]
    assert len(turns) == (3 if language == "C" else 1)
    assert sum(turns) > 20

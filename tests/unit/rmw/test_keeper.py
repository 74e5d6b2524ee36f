"""Keepers of two pods with real sockets, and real processes with the layer: which of them works."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from urllib.request import urlopen

import attrs
import pytest

from rigel_inpod.rmw_notes import STOP, WAIT, WORK
from tests.support.layer import KEEPER, Node, name, start_keeper
from tests.support.until import until
from tests.unit.rmw.conftest import Start

pytestmark = pytest.mark.programs


@attrs.define
class Pod:
    """A node with the layer, and its keeper."""

    node: Node
    environ: dict[str, str]
    keeper: subprocess.Popen[str]

    @property
    def mode(self) -> int:
        """What its node may do."""
        return self.node.notes.mode

    def call(self, *words: str) -> subprocess.CompletedProcess[str]:
        """Run the script beside its keeper."""
        line = [sys.executable, "-S", "-E", "-B", str(KEEPER), *words]
        return subprocess.run(line, env=self.environ, capture_output=True, text=True, timeout=60)


@pytest.fixture
def port() -> int:
    """The first of four ports that no other test has."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.fixture
def pod(start: Start, port: int) -> Iterator[Callable[..., Pod]]:
    """Starts pods of one workload, all at 127.0.0.1."""
    pods: list[Pod] = []

    def begin(script: Path = KEEPER, **more: str) -> Pod:
        number = len(pods)
        node = start("wait", directory=f"pod-{number}")
        more["NODE"] = str(node.process.pid)
        pods.append(Pod(node, *start_keeper(node, f"talker-{number}", port, script, **more)))
        name(node).do("create p /out 0")
        node.do("publish /out 1")  # it acts, so it is fit
        return pods[-1]

    yield begin
    for one in pods:
        one.keeper.kill()
        with one.keeper:
            pass


def until_keepers(port: int, count: int) -> None:
    """Wait until so many keepers listen: a new one sees the others from then on."""

    def list_ports() -> set[int]:
        tables = (Path("/proc/net", name).read_text() for name in ("tcp", "tcp6"))
        rows = [row.split() for table in tables for row in table.splitlines()[1:]]
        return {int(row[1].rpartition(":")[2], 16) for row in rows if row[3] == "0A"}

    until(lambda: len(list_ports() & {*range(port, port + 4)}) == count, f"{count} keepers")


def until_mode(pod: Pod, mode: int) -> None:
    """Wait until a pod's node is in a mode."""
    until(lambda: pod.mode == mode, f"mode {mode}", 60, every=0.02)


def hand_over(pod: Callable[..., Pod]) -> tuple[Pod, Pod]:
    """Return a pod that waits, since the one that started after it has taken over."""
    one = pod()
    until_mode(one, WORK)
    other = pod()
    until_mode(other, WORK)
    until(lambda: one.call("state").stdout == "waits, talker-1 works\n", "the old one waits")
    return one, other


def test_the_first_works_and_the_second_takes_over(pod: Callable[..., Pod]) -> None:
    """Then the first one waits, and both say what they have reached."""
    one = pod()
    until_mode(one, WORK)
    other = pod()
    until_mode(other, WORK)
    until(lambda: one.mode in (STOP, WAIT), "end of the old one's work")
    assert other.call("state").returncode == 0
    until(lambda: one.call("state").stdout == "waits, talker-1 works\n", "the old one's state")
    other.keeper.send_signal(signal.SIGTERM)
    assert "works, took over from talker-0 in " in other.keeper.communicate(timeout=60)[0]


def test_pods_with_many_topics_find_each_other(pod: Callable[..., Pod]) -> None:
    """A greeting is short whatever the node has: strangers may not send much."""
    one = pod()
    for number in range(300):
        one.node.do(f"create s /in/{number} 0")
    until_mode(one, WORK)
    other = pod()
    until(lambda: "took over" in other.call("state").stdout, "hand-over")


def test_a_worker_whose_keeper_gets_no_processor_time_is_waited_for(
    pod: Callable[..., Pod], port: int
) -> None:
    """Its kernel accepts connections; else both would work until it has time."""
    one = pod()
    until_mode(one, WORK)
    one.keeper.send_signal(signal.SIGSTOP)
    other = pod()
    until_keepers(port, 2)
    end = time.monotonic() + 6
    while time.monotonic() < end:
        assert other.mode == WAIT
        time.sleep(0.05)
    one.keeper.send_signal(signal.SIGCONT)
    until(lambda: "took over from talker-0" in other.call("state").stdout, "hand-over")


def test_a_worker_whose_machine_is_slow_to_connect_is_waited_for(
    pod: Callable[..., Pod], port: int
) -> None:
    """The kernel leaves connections unanswered while too many others wait, and is asked again."""
    one = pod()
    until_mode(one, WORK)
    one.keeper.send_signal(signal.SIGSTOP)
    with ExitStack() as strangers:
        for _ in range(64):
            sock = strangers.enter_context(socket.socket())
            sock.setblocking(False)
            sock.connect_ex(("127.0.0.1", port))
        other = pod()
        until_keepers(port, 2)
        end = time.monotonic() + 5
        while time.monotonic() < end:
            assert other.mode == WAIT
            time.sleep(0.05)
    one.keeper.send_signal(signal.SIGCONT)
    until(lambda: "took over from talker-0" in other.call("state").stdout, "hand-over")


@pytest.mark.parametrize("what", ["node and keeper", "node"])
def test_if_the_worker_dies_the_one_that_waits_works(pod: Callable[..., Pod], what: str) -> None:
    """Whether its keeper can still say so or not."""
    one, other = hand_over(pod)
    if "keeper" in what:
        other.keeper.kill()
    other.node.process.kill()
    other.node.process.wait()
    until_mode(one, WORK)


#: Where the keeper sends a message of a switch; and what ends it there, with its node.
SENDS = """                link.outbox += json.dumps(message).encode() + b"\\n"
                self._send(now, link)
"""
ENDS = """                if message["type"] == os.environ["STEP"]:
                    os.kill(int(os.environ["NODE"]), 9)
                    os.kill(os.getpid(), 9)
"""


@pytest.mark.parametrize("sent", [False, True], ids=["before", "after"])
@pytest.mark.parametrize(
    ("step", "dies"),
    [*((step, "new") for step in ("take", "goals", "hold"))]
    + [*((step, "old") for step in ("go", "draining", "drained", "stopped"))],
)
def test_one_that_is_killed_at_any_step_of_a_switch_is_replaced(
    pod: Callable[..., Pod], tmp_path: Path, step: str, dies: str, *, sent: bool
) -> None:
    """Before or after it has said so: the other one works, whichever that is."""
    scripts = Path(shutil.copytree(KEEPER.parent, tmp_path / "scripts"))
    text = KEEPER.read_text("utf-8")
    assert text.count(SENDS) == 1
    (scripts / "keeper.py").write_text(text.replace(SENDS, SENDS + ENDS if sent else ENDS + SENDS))
    pods = []
    for which in ("old", "new"):
        script = scripts / "keeper.py" if which == dies else KEEPER
        pods.append(pod(script, STEP=step))
        pods[-1].node.do("create v /work/_action/send_goal 0")
        if which == "old":
            until_mode(pods[0], WORK)
    dead, left = pods if dies == "old" else pods[::-1]
    assert dead.keeper.wait(60) == -signal.SIGKILL
    until_mode(left, WORK)


def test_a_silent_worker_is_replaced_and_hands_over_again(pod: Callable[..., Pod]) -> None:
    """As in a container that is paused: its kernel keeps the connection."""
    one, other = hand_over(pod)
    other.keeper.send_signal(signal.SIGSTOP)
    until_mode(one, WORK)
    assert other.mode == WORK
    other.keeper.send_signal(signal.SIGCONT)
    until(lambda: (one.mode in (STOP, WAIT), other.mode) == (True, WORK), "the newer one's work")


def test_a_worker_whose_keeper_dies_goes_on(pod: Callable[..., Pod]) -> None:
    """Until another pod is there; its node keeps its mode."""
    one = pod()
    until_mode(one, WORK)
    one.keeper.kill()
    one.keeper.wait()
    one.node.do("publish /out 2")
    assert one.mode == WORK


def test_leave_succeeds_if_another_one_works_then(pod: Callable[..., Pod]) -> None:
    """`stop.sh` decides by it whether to make a lifecycle node's last transitions."""
    one, other = hand_over(pod)
    assert other.call("leave", "--wait", "60").returncode == 0
    assert one.mode == WORK
    began = time.monotonic()
    assert one.call("leave", "--wait", "60").returncode == 1
    assert time.monotonic() < began + 30  # no one is waited for
    assert one.mode == WORK  # until its processes are ended


def test_strangers_change_nothing(pod: Callable[..., Pod], port: int) -> None:
    """Neither rubbish, nor too much of it, nor a keeper of another workload that works longer."""
    one = pod()
    until_mode(one, WORK)
    hello = {"type": "hello", "workload": "n/r/listener", "pod": "x", "run": "1", "role": "works"}
    hello |= {"term": 99, "age": 1, "alive": True, "fit": True, "leaving": False, "goals": 0}
    hello |= {"worker": "", "matched": {}, "nodes": [], "others": []}
    texts = [
        b"\n",
        b"{}\n",
        b"[1]\n",
        b"\xff\xfe\n",
        b'{"type": 1e999}\n',
        b"GET / HTTP/1.1\r\n\r\n",
    ]
    texts += [b"x" * 100_000, b"[" * 4000 + b"\n", json.dumps(hello).encode() + b"\n"]
    for text in texts:
        with socket.create_connection(("127.0.0.1", port), 10) as stranger, suppress(OSError):
            stranger.sendall(text)
            while stranger.recv(4096):  # what it is itself; then it closes
                pass
    silent = [socket.create_connection(("127.0.0.1", port), 10) for _ in range(50)]
    with urlopen(f"http://127.0.0.1:{port}/notes", timeout=30) as answer:
        (process,) = json.load(answer)["processes"]
    assert {"/n", "/out"} <= {entity["name"] for entity in process["entities"]}
    other = pod()
    until_mode(other, WORK)
    for stranger in silent:
        stranger.close()

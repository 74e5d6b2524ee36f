"""What a pod's probe and its stop hook say to the gate in front of the master."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import rigel_inpod
from tests.support.pythons import find_python
from tests.support.rosgraph import Rpc

pytestmark = pytest.mark.programs

ROOM = Path(rigel_inpod.__file__).parent
HOST = os.uname().nodename


class Gate(Rpc):
    """A gate, the master behind it, and a node, all at one address.

    Attributes:
        waiting: [[name, state], ...] of nodes that wait here, at this address.
        elsewhere: the same of another pod's.
        names: what a hand-over returns.
        described, handed_over: the arguments of the calls, without the caller.
    """

    def __init__(self) -> None:
        super().__init__()
        self.owner = "http://10.9.9.9:1/"
        self.waiting: list[list[str]] = []
        self.elsewhere: list[list[str]] = []
        self.names: list[str] = []
        self.described: list[list[str]] = []
        self.handed_over: list[list[str]] = []
        self.looked_up: list[str] = []
        self.is_old = False
        self.answers_node = True

    def rigelDescribePod(self, caller: str, *words: str) -> list[object]:
        if self.is_old:
            raise ValueError("no such method")
        self.described.append(list(words))
        here = [[name, self.uri, state, self.owner] for name, state in self.waiting]
        other = [[name, "http://10.8.8.8:1/", state, ""] for name, state in self.elsewhere]
        return [1, "", here + other]

    def rigelHandOver(self, caller: str, *words: str) -> list[object]:
        self.handed_over.append(list(words))
        return [1, "", self.names]

    def getPid(self, caller: str) -> list[object]:
        if not self.answers_node:
            raise ValueError("broken")
        return [1, "", 1]

    def lookupNode(self, caller: str, name: str) -> list[object]:
        self.looked_up.append(name)
        return [1, "", self.uri] if name == "/here_7_1" else [-1, "unknown node", ""]

    def getSystemState(self, caller: str) -> list[object]:
        return [1, "", [[["/rosout", ["/other", "/here_7_1"]]], [], []]]

    def getParam(self, caller: str, key: str) -> list[object]:
        return [1, "", "run"]


@pytest.fixture
def gate() -> Iterator[Gate]:
    found = Gate()
    yield found
    found.close()


every_python = pytest.mark.parametrize("python", ["2.7", "3.6", "3"], indirect=True)


@pytest.fixture
def python(request: pytest.FixtureRequest) -> str:
    """A Python of the version that a test names, else this one."""
    version = getattr(request, "param", "3")
    return sys.executable if version == "3" else find_python(version)


Probe = Callable[..., tuple[int, str]]


@pytest.fixture
def probe(python: str, gate: Gate, tmp_path: Path) -> Probe:
    """Run ready.py as ready.sh does; its exit code and its line."""

    def run(*words: str, **env: str) -> tuple[int, str]:
        own = {"ROS_MASTER_URI": gate.uri, "ROS_IP": "127.0.0.1", "TMPDIR": str(tmp_path)}
        done = subprocess.run(
            [python, "-S", "-E", "-B", str(ROOM / "ready.py"), *words],
            capture_output=True,
            text=True,
            env={**own, "RIGEL_K8S_WORKLOAD": "talker", **env},
        )
        assert done.stderr == ""
        return done.returncode, done.stdout.rstrip("\n")

    return run


@every_python
def test_a_node_that_waits_is_ready(probe: Probe, gate: Gate):
    """Kubernetes ends the old pod then, and the name moves; the line says what it waits for."""
    gate.waiting = [["/talker", "quiet"]]
    code, line = probe("node")  # other processes that listen here may have a node as well
    assert code == 0
    assert line.endswith("/talker waits to take over")
    assert "/talker" not in gate.looked_up, "the name is another node's at the master"


@every_python
def test_a_node_that_still_registers_is_not_ready(probe: Probe, gate: Gate):
    gate.waiting = [["/talker", "busy"]]
    assert probe("node") == (1, "/talker still registers; it waits to take over")


def test_one_busy_node_of_several_keeps_the_pod_unready(probe: Probe, gate: Gate):
    gate.waiting = [["/one", "quiet"], ["/two", "busy"]]
    assert probe("node") == (1, "/two still registers; it waits to take over")


def test_a_waiting_node_that_does_not_answer_is_not_ready(probe: Probe, gate: Gate):
    gate.waiting = [["/talker", "quiet"]]
    gate.answers_node = False
    code, line = probe("node")
    assert code == 1
    assert "/talker" in line
    assert "does not answer: it answered with a fault" in line


@every_python
def test_another_pods_waiting_node_is_not_ours(probe: Probe, gate: Gate):
    """With host networking several pods have one address."""
    gate.elsewhere = [["/talker", "busy"], ["/camera", "quiet"]]
    assert probe("node") == (0, "ready: /here_7_1")


def test_a_node_that_has_its_name_waits_no_more(probe: Probe, gate: Gate):
    """The same pod's next probe."""
    gate.waiting = [["/here_7_1", "quiet"]]
    assert probe("node") == (0, "ready: /here_7_1 waits to take over")
    gate.waiting = []
    assert probe("node") == (0, "ready: /here_7_1")


@pytest.mark.parametrize(
    ("env", "described"),
    [
        ({}, [HOST, "talker", "127.0.0.1"]),
        ({"ROS_HOSTNAME": "robot"}, [HOST, "talker", "robot"]),
    ],
)
def test_a_pod_describes_itself(
    probe: Probe, gate: Gate, env: dict[str, str], described: list[str]
):
    """Its name, its workload, and the address that its nodes advertise."""
    assert probe("node", **env)[0] == 0
    assert gate.described == [described]


def test_a_pod_that_does_not_hand_over_says_nothing(probe: Probe, gate: Gate):
    gate.waiting = [["/talker", "busy"]]
    assert probe("node", RIGEL_K8S_WORKLOAD="") == (0, "ready: /here_7_1")
    assert gate.described == []


@every_python
def test_a_master_without_a_gate_is_no_trouble(probe: Probe, gate: Gate):
    """It knows no such method."""
    gate.is_old = True
    assert probe("node") == (0, "ready: /here_7_1")


# -- the stop hook's part --


@every_python
def test_a_pod_that_ends_hands_over(probe: Probe, gate: Gate):
    """It gives newcomers these seconds to become ready."""
    gate.names = ["/talker", "/camera"]
    assert probe("leave", "--wait", "2") == (0, "handed over: /talker, /camera")
    assert gate.handed_over == [["2.0", "127.0.0.1"]]


@every_python
def test_a_pod_for_which_no_one_waits_has_nothing_to_hand_over(probe: Probe, gate: Gate):
    assert probe("leave", "--wait", "2") == (1, "no one waits")


@every_python
def test_without_a_gate_nothing_is_handed_over(probe: Probe, gate: Gate):
    """And the stop hook goes on at once."""
    started = time.monotonic()
    code, line = probe("leave", "--wait", "300", ROS_MASTER_URI="http://127.0.0.1:1")
    assert (code, line) == (1, "nothing is handed over: Connection refused")
    assert probe("leave", ROS_MASTER_URI="")[0] == 1
    assert time.monotonic() - started < 60


@pytest.mark.parametrize("words", [("leave", "--components", "/a"), ("leave", "--wait", "soon")])
def test_wrong_arguments(probe: Probe, words: tuple[str, ...]):
    assert probe(*words)[0] == 2

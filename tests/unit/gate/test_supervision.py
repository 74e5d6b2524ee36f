"""`python -m rigel_gate` as a process: its worker, its signals, its ports, its journal."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import xmlrpc.client
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from unittest.mock import AsyncMock

import attrs
import pytest

import rigel_k8s
from rigel_gate.__main__ import Start, listen
from rigel_gate.program import program
from tests.support.pythons import find_python
from tests.support.rosgraph import RosGraph, ros_graph
from tests.support.until import until

pytestmark = pytest.mark.programs

#: Makes the first worker get SIGTERM before it has said what that means to it.
EARLY = """
import os, signal, sys
fork, first = os.fork, []
def early():
    worker = fork()
    if worker == 0 and not first:
        os.kill(os.getpid(), signal.SIGTERM)
    first.append(worker)
    return worker
os.fork = early
from rigel_gate.__main__ import main
sys.exit(main(sys.argv[1:]))
"""
#: Kills each worker that reads the file, as the kernel does for want of memory.
DEADLY = """
import os, signal, sys
from rigel_gate import keeper
from rigel_gate.__main__ import main
from rigel_gate.memory import Journal
keeper.GIVE_UP = 4
Journal.read = lambda self: os.kill(os.getpid(), signal.SIGKILL)
sys.exit(main(sys.argv[1:]))
"""


@attrs.define
class Running:
    """A gate as a process; `lines` are what it has printed."""

    process: subprocess.Popen[str]
    port: int
    lines: list[str]

    @property
    def proxy(self) -> xmlrpc.client.ServerProxy:
        """The gate as a node sees it."""
        return xmlrpc.client.ServerProxy(f"http://127.0.0.1:{self.port}/")

    def worker(self) -> int:
        """Return the process id of the worker."""
        pid = self.process.pid
        return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])

    def end(self, number: signal.Signals = signal.SIGTERM) -> int:
        """Send a signal; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(60)


def kill_all(pid: int) -> None:
    """Kill a gate, with a worker that its first process has not ended."""
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


@pytest.fixture
def graph() -> Iterator[RosGraph]:
    with ros_graph() as found:
        yield found


@pytest.fixture
def begin(tmp_path: Path, graph: RosGraph) -> Iterator[Callable[..., Running]]:
    """Start a gate in front of the graph's master."""
    with ExitStack() as cleanup:

        def run(
            *, code: str = "", python: str = sys.executable, port: int = 0, path: str = ""
        ) -> Running:
            port = port or free_port()
            words = ["-c", code] if code else ["-m", "rigel_gate"]
            words += ["--port", str(port), "--hand-over-port", str(free_port())]
            words += ["--master-port", str(graph.master.port)]
            process = subprocess.Popen(
                [python, *words, "--journal", str(tmp_path / "journal")],
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
                env={
                    "PYTHONPATH": path or str(Path(rigel_k8s.__file__).parents[1]),
                    "ROS_HOSTNAME": "ros-master",
                },
            )
            found = Running(process, port, [])
            reading = threading.Thread(target=lambda: found.lines.extend(process.stdout or ()))
            reading.start()
            cleanup.callback(lambda: process.stdout and process.stdout.close())
            cleanup.callback(reading.join)
            cleanup.callback(process.wait, 60)
            cleanup.callback(kill_all, process.pid)
            return found

        yield run


def answers(gate: Running) -> bool:
    with gate.proxy as proxy:
        return proxy.getParam("/tool", "/run_id") == [1, "", "run-1"]


def wait_for(gate: Running) -> None:
    despite = (OSError, xmlrpc.client.Fault)
    until(lambda: answers(gate), "an answer", 60, every=0.02, despite=despite)


def test_a_gate_answers_until_sigterm(begin: Callable[..., Running]):
    """As soon as its master does; its end is no failure of its container."""
    gate = begin()
    wait_for(gate)
    with gate.proxy as proxy:
        assert proxy.getUri("/tool") == [1, "", f"http://ros-master:{gate.port}/"]
    assert gate.end() == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_worker_ends_with_the_first_process(
    begin: Callable[..., Running], number: signal.Signals
):
    """Nothing of it holds the ports."""
    gate = begin()
    wait_for(gate)
    worker = gate.worker()
    assert gate.end(number) == 0
    assert not Path(f"/proc/{worker}").exists()
    listen(gate.port).close()


def test_a_worker_that_is_killed_is_back(begin: Callable[..., Running], graph: RosGraph):
    """It knows everything, and a caller that comes meanwhile waits at the door."""
    gate = begin()
    wait_for(gate)
    node = graph.program(["/chatter"])
    with gate.proxy as proxy:
        proxy.registerSubscriber("/talker", "/chatter", "std_msgs/String", node.uri)
    for _ in range(2):
        worker = gate.worker()
        os.kill(worker, signal.SIGKILL)
        with socket.create_connection(("127.0.0.1", gate.port), 60) as waiting:
            waiting.sendall(b"GET / HTTP/1.0\r\n\r\n")
            assert waiting.recv(100).startswith(b"HTTP/1.1 501"), "the next worker's answer"
        until(lambda old=worker: gate.worker() != old, "another worker", 60, every=0.02)
        wait_for(gate)
    with gate.proxy as proxy:
        assert '"nodes": 1' in proxy.rigelDescribeGate("/tool")[2]
    assert gate.end() == 0
    again = "gate: started again (the worker ended with status 9)\n"
    until(lambda: gate.lines.count(again) == 2, f"two lines of {again}")


def test_a_file_with_which_no_worker_can_start_is_given_up(begin: Callable[..., Running]):
    """After some of them; or nothing would answer until a person deletes the pod."""
    gate = begin(code=DEADLY)
    wait_for(gate)
    with gate.proxy as proxy:
        notes = json.loads(proxy.rigelDescribeGate("/tool")[2])["notes"]
    why = "4 gates were killed while they began with it"
    assert notes == [f"the memory in the file of the pod is not used: {why}"]
    again = "started again"
    until(lambda: len([line for line in gate.lines if again in line]) == 4, "4 more starts")
    os.kill(gate.worker(), signal.SIGKILL)
    until(lambda: len([line for line in gate.lines if again in line]) > 5, "a trial", 60)
    wait_for(gate)
    assert gate.end() == 0


def test_only_a_worker_that_was_killed_with_the_file_in_use_counts():
    """One that a person kills before, or after its start, proves nothing."""
    start, failures = Start(), []
    ready = AsyncMock()
    for steps in ("", "u", "u", "", "u", "us", "", "u"):
        start.begin()
        if "u" in steps:
            start.use_file()
        if "s" in steps:
            asyncio.run(start.finish(ready))
        start.end()
        failures.append(start.failures)
    assert failures == [0, 1, 2, 2, 3, 0, 0, 1]


def test_a_worker_that_is_told_to_end_at_its_start_ends(begin: Callable[..., Running]):
    """Kubernetes would have to kill the pod."""
    gate = begin(code=EARLY)
    until(lambda: any("started again" in line for line in gate.lines), "a second worker", 60)
    wait_for(gate)
    assert gate.end() == 0


def test_a_gate_may_be_ended_at_any_time_of_its_start(begin: Callable[..., Running]):
    for pause in (0.15, 0.25):
        gate = begin()
        threading.Event().wait(pause)
        assert gate.end() in (0, -signal.SIGTERM), "the latter before it was a gate at all"


def test_a_port_that_is_taken_ends_it(begin: Callable[..., Running]):
    """Exit code 1, and a line that says why: the container is started again."""
    with socket.socket() as taken:
        taken.bind(("0.0.0.0", 0))
        taken.listen()
        gate = begin(port=taken.getsockname()[1])
        assert gate.process.wait(60) == 1
    until(lambda: gate.lines, "a line", 60, every=0.02)
    assert gate.lines == ["gate: a port is taken: Address already in use\n"]


def test_a_journal_of_an_earlier_life_is_read(begin: Callable[..., Running], tmp_path: Path):
    """With a stale line in it."""
    api = "http://127.0.0.1:1/"
    lines = [
        '["run", "run-1"]',
        '["an event of another version"]',
        f'["wait", "publisher", "/t", "/n", "{api}", "t/T"]',
        '["wait", "publ',
    ]
    (tmp_path / "journal").write_text("\n".join(lines))
    gate = begin()
    until(lambda: any("has ended before" in line for line in gate.lines), "a look", 60, every=0.02)
    assert any(f"/n at {api} has ended before it took over" in line for line in gate.lines)
    assert not any("failed" in line or "error" in line for line in gate.lines)


def test_the_mounted_files_run_on_python_3_8(
    begin: Callable[..., Running], tmp_path: Path, graph: RosGraph
):
    """An official ROS image has no other Python, and nothing of this package."""
    room = tmp_path / "mounted" / "rigel_gate"
    room.mkdir(parents=True)
    for name, text in program().items():
        (room / name).write_text(text)
    gate = begin(python=find_python("3.8"), path=str(tmp_path / "mounted"))
    wait_for(gate)
    node = graph.program(["/chatter"])
    with gate.proxy as proxy:
        answer = proxy.registerSubscriber("/talker", "/chatter", "std_msgs/String", node.uri)
        assert answer == [1, "", []]
    assert gate.end() == 0
    assert not any("error" in line for line in gate.lines)

"""What the probe of DDS says of real processes with a participant's sockets, and of interfaces."""

from __future__ import annotations

import itertools
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from types import ModuleType

import pytest

from tests.support.rosgraph import until

pytestmark = pytest.mark.programs

#: Binds UDP ports, says so, and reads what it is sent where it is to: not at those with a minus.
PARTICIPANT = """
import select, socket, sys
reads, ports = sys.argv[1] == "reads", [port.lstrip("-") for port in sys.argv[2:]]
sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in ports]
for one, port in zip(sockets, ports):
    one.bind(("127.0.0.1", int(port)))
print("up", flush=True)
heard = [one for one, port in zip(sockets, sys.argv[2:]) if port[0] != "-"]
while select.select(heard if reads else [sys.stdin], [], [])[0]:
    for one in select.select(heard, [], [], 0)[0]:
        one.recv(100)
"""
#: Connects to a TCP port.
CLIENT = """
import socket, sys
there = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
print("up", flush=True)
sys.stdin.read()
"""
DOMAIN = 40 + os.getpid() % 20  # others on this machine may have participants
PORT = 7410 + 250 * DOMAIN


class Pod:
    """Processes of this container, and what the probe says."""

    def __init__(self, dds_ready: ModuleType, cleanup: ExitStack) -> None:
        self.dds_ready, self._cleanup = dds_ready, cleanup
        self.processes: list[int] = []

    def starts(self, text: str, *words: str) -> int:
        """Start a process and wait until it is up; its id."""
        command = [sys.executable, "-S", "-c", text, *words]
        pipe = subprocess.PIPE
        process = self._cleanup.enter_context(
            subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True)
        )
        self._cleanup.callback(process.kill)
        assert process.stdout is not None
        assert process.stdout.readline() == "up\n"
        self.processes.append(process.pid)
        return process.pid

    def participates(self, *, reads: bool = True, port: int = PORT) -> int:
        ports = (str(port), str(port + 1))
        return self.starts(PARTICIPANT, "reads" if reads else "hangs", *ports)

    def stop(self, pid: int) -> None:
        """Stop a process by a signal; the kernel takes a moment."""
        os.kill(pid, signal.SIGSTOP)
        until(lambda: self.dds_ready.dds_local.state(pid) == "T", "the process is stopped")

    def probe(self, *words: str) -> str:
        try:
            return str(self.dds_ready.look(self.dds_ready.Arguments(list(words))))
        except self.dds_ready.NotReady as why:
            return str(why)

    def dds(self, *words: str) -> str:
        return self.probe("dds", "--domain", str(DOMAIN), *words)


@pytest.fixture
def visitors() -> set[int]:
    return set()


@pytest.fixture
def pod(
    script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch, visitors: set[int]
) -> Iterator[Pod]:
    monkeypatch.setattr(script("container"), "visitors", lambda: visitors)
    with ExitStack() as cleanup:
        found = Pod(script("dds_ready"), cleanup)
        monkeypatch.setattr(script("container"), "processes", lambda: found.processes)
        yield found


def test_a_participant_that_reads_is_ready(pod: Pod):
    pid = pod.participates()
    line = pod.dds()
    assert line.startswith(f"process {pid} (")
    assert line.endswith(f") at domain {DOMAIN}")


def test_nobody_takes_part_yet(pod: Pod):
    line = f"no process of this container takes part in DDS domain {DOMAIN} yet (UDP port"
    assert pod.dds().startswith(line)


def test_one_socket_in_a_domains_range_is_no_participant(pod: Pod):
    """A port of the system's choice may lie there."""
    pod.starts(PARTICIPANT, "reads", str(PORT))
    assert "takes part in DDS domain" in pod.dds()
    assert "yet" in pod.dds()


def test_sockets_for_sending_are_not_asked(pod: Pod, monkeypatch: pytest.MonkeyPatch):
    """Nobody reads them. The system chose their ports: in the domain's range, or two neighbors."""
    monkeypatch.setattr(pod.dds_ready, "READS", 30.0)
    own = [PORT - 10, PORT, PORT + 1]  # it hears announcements, too
    chance = [PORT + 20, PORT + 500, PORT + 501]
    pod.starts(PARTICIPANT, "reads", *map(str, own), *(f"-{port}" for port in chance))
    assert pod.dds().endswith(f") at domain {DOMAIN}")
    assert pod.probe("dds").endswith(f") at domain {DOMAIN}")
    assert pod.probe("dds").count("at domain") == 1


def test_a_stopped_participant_says_so_at_once(pod: Pod):
    """Seconds later it would only be told to hang."""
    pid = pod.participates()
    pod.stop(pid)
    assert pod.dds().endswith("is stopped by a signal")
    os.kill(pid, signal.SIGCONT)
    assert pod.dds().endswith(f"at domain {DOMAIN}")


def test_a_participant_that_does_not_read_hangs(pod: Pod, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(pod.dds_ready, "READS", 0.3)
    pod.participates(reads=False)
    line = pod.dds()
    assert f"hangs: what was sent to its UDP port {PORT} was not read within" in line


def test_a_participant_that_is_behind_reads(pod: Pod, monkeypatch: pytest.MonkeyPatch):
    """One that is sent more than it reads is connected, though its queue is never empty."""
    lengths = itertools.cycle([900, 1000, 800])
    found = [pod.dds_ready.dds_local.Socket("127.0.0.1", PORT, 0, "7")]

    def sockets() -> list[object]:
        found[0].waiting = next(lengths)
        return found

    monkeypatch.setattr(pod.dds_ready.dds_local, "udp_sockets", sockets)
    assert pod.dds_ready.dds_local.is_read("7", 5)
    lengths = itertools.count(900)
    assert not pod.dds_ready.dds_local.is_read("7", 0.3)


def test_a_participant_that_never_reads_fails_the_liveness_probe(
    pod: Pod,
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
):
    """Not before the time is over, nor one that is sent nothing, or that reads."""
    probe = script("rmw_ready").main
    monkeypatch.setenv("RIGEL_RMW", str(tmp_path))
    pod.participates(port=PORT + 2)
    pid = pod.participates(reads=False)
    assert probe(["stuck", "0"]) == 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mouth:
        for port in (PORT, PORT + 2):
            mouth.sendto(b"anyone there?", ("127.0.0.1", port))
    capsys.readouterr()
    until(lambda: probe(["stuck", "2"]) == 1, "the probe fails")
    said = capsys.readouterr().out
    assert f"process {pid} (" in said
    assert f") has not read its UDP port {PORT} for " in said
    assert probe(["stuck", "3600"]) == 0
    pod.stop(pid)
    os.kill(pid, signal.SIGKILL)
    until(lambda: probe(["stuck", "2"]) == 0, "the probe passes: its socket is closed")


def test_another_domain_is_named(pod: Pod):
    pid = pod.participates(port=PORT + 250)
    line = pod.dds()
    assert line.startswith(f"process {pid} (")
    assert f"takes part in DDS domain {DOMAIN + 1} instead of {DOMAIN}" in line


def test_what_exec_started_does_not_count(pod: Pod, visitors: set[int]):
    """`rigel exec NODE -- ros2 topic echo` neither makes a pod ready nor, stopped, unready."""
    tool = pod.participates(port=PORT + 2)
    visitors.add(tool)
    assert "yet" in pod.dds()
    own = pod.participates()
    pod.stop(tool)
    assert pod.dds().startswith(f"process {own} (")


def test_a_daemon_of_the_command_line_does_not_count(
    pod: Pod, script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch
):
    pod.participates()
    assert pod.dds().startswith("process ")
    monkeypatch.setattr(script("container"), "command", lambda _: "python3 -c ros2-daemon")
    assert "yet" in pod.dds()


def test_a_discovery_server_is_known_by_its_port(pod: Pod):
    port = str(PORT + 5)
    assert pod.probe("dds", "--port", port).startswith("no process of this container has UDP port")
    pod.starts(PARTICIPANT, "reads", port)
    assert pod.probe("dds", "--port", port).endswith(f"at port {port}")


def test_a_zenoh_client_is_connected_to_its_router(pod: Pod, visitors: set[int]):
    with socket.create_server(("127.0.0.1", 0)) as router:
        port = str(router.getsockname()[1])
        line = f"no process of this container is connected to a zenoh router yet (TCP port {port})"
        assert pod.probe("zenoh", "--port", port) == line
        pid = pod.starts(CLIENT, port)
        assert pod.probe("zenoh", "--port", port) == "connected to the zenoh router at 127.0.0.1"
        pod.stop(pid)
        assert pod.probe("zenoh", "--port", port) == f"process {pid} is stopped by a signal"
        os.kill(pid, signal.SIGCONT)
        visitors.add(pid)
        assert pod.probe("zenoh", "--port", port) == line


@pytest.mark.parametrize(
    ("addresses", "up", "says"),
    [
        ({}, True, "net1 is missing: Multus did not attach"),
        ({"net1": None}, True, "net1 has no IPv4 address"),
        ({"net1": "10.0.0.1"}, False, "net1 is down"),
        ({"net1": "10.0.0.1"}, True, "no process of this container"),
    ],
)
def test_the_second_network(
    pod: Pod,
    monkeypatch: pytest.MonkeyPatch,
    addresses: dict[str, str | None],
    says: str,
    *,
    up: bool,
):
    interfaces = pod.dds_ready.interfaces
    monkeypatch.setattr(interfaces, "addresses", lambda: addresses)
    monkeypatch.setattr(interfaces, "address_of", addresses.get)
    monkeypatch.setattr(interfaces, "is_up", lambda _: up)
    assert pod.dds("--interface", "net1").startswith(says)


def test_real_interfaces(script: Callable[[str], ModuleType]):
    """The kernel's own answers."""
    interfaces = script("interfaces")
    assert interfaces.address_of("lo") == "127.0.0.1"
    assert interfaces.is_up("lo")
    assert interfaces.address_of("nothing0") is None
    assert not interfaces.is_up("nothing0")
    assert "lo" not in interfaces.addresses()
    index = socket.if_nametoindex("lo").to_bytes(4, sys.byteorder)
    assert interfaces.membership("239.255.0.1", "lo") == bytes([239, 255, 0, 1, 0, 0, 0, 0]) + index


@pytest.mark.parametrize(
    ("words", "code"),
    [((), 2), (("zenoh",), 2), (("dds", "--domain"), 2), (("dds", "--what", "1"), 2)]
    + [(("dds", "--domain", str(DOMAIN), "--wait", "0.3"), 1)],
)
def test_exit_codes(pod: Pod, words: tuple[str, ...], code: int):
    assert pod.dds_ready.main(list(words)) == code


def test_ready_ends_with_0(pod: Pod, capsys: pytest.CaptureFixture[str]):
    pod.participates()
    assert pod.dds_ready.main(["dds", "--domain", str(DOMAIN)]) == 0
    assert capsys.readouterr().out.startswith("ready: process ")


@pytest.mark.parametrize(
    ("option", "script_name"),
    [("--transitions", "transitions.py"), ("--components", "components.py")],
)
def test_a_node_is_ready_once_the_script_beside_it_is_done(
    pod: Pod,
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    option: str,
    script_name: str,
):
    """The line is the script's own; before it has one, it says which script it is."""
    progress = script("progress")
    monkeypatch.setattr(progress, "FILES", (str(tmp_path / "file"),))
    pod.participates()
    assert pod.dds(option, "/n") == f"{script_name} has not started yet for /n"
    progress.Progress("failed", "/n cannot", pid=os.getpid()).save()
    assert pod.dds(option, "/n") == "/n cannot"
    progress.Progress("done", "/n has").save()
    assert pod.dds(option, "/n").endswith(", /n has")


@pytest.mark.parametrize("hands_over", [False, True])
def test_a_node_with_the_layer_is_asked_itself(
    pod: Pod,
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    hands_over: bool,  # noqa: FBT001
):
    """After its part in DDS; the directory and the Service are in its environment."""
    asked: list[object] = []
    found = script("rmw_ready")

    def look(*words: object) -> list[str]:
        asked.append(words)
        if len(asked) > 1:
            raise found.NotReady("it waits")
        return ["/talker"]

    monkeypatch.setattr(found, "look", look)
    monkeypatch.setenv("RIGEL_RMW", "/run/x")
    if hands_over:
        monkeypatch.setenv("RIGEL_K8S_PEERS", "talker-pods")
    assert pod.dds("--node", "/talker").startswith("no process")
    pod.participates()
    assert pod.dds("--node", "/talker").endswith(", /talker")
    assert pod.dds() == "it waits"
    assert asked == [("/run/x", "/talker", hands_over), ("/run/x", None, hands_over)]

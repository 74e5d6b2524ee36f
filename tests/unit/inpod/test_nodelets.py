"""The loader of nodelets: what it sends, whom it asks, and what it does with a refusal."""

from __future__ import annotations

import json
import signal
import socket
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from tempfile import NamedTemporaryFile
from types import ModuleType, SimpleNamespace
from typing import Any

import attrs
import pytest

from .conftest import ROOM

COMPONENT = {
    "name": "/robot/eye",
    "plugin": "car/Eye",
    "parameters": {"rate": 2},
    "remappings": {"/robot/image": "/image"},
}
GRANTED, REFUSED, FAILED = (b"\1", b"\1"), (b"\1", b"\0"), (b"\0", b"no such plugin")


def block(data: bytes) -> bytes:
    return struct.pack("<I", len(data)) + data


@attrs.define
class Manager:
    """A service that answers as roscpp does, one answer for each call.

    Attributes:
        asked: (header, request) of each call.
    """

    answers: list[tuple[bytes, bytes]]
    asked: list[tuple[bytes, bytes]] = attrs.field(factory=list)
    listener: socket.socket = attrs.field(factory=lambda: socket.create_server(("127.0.0.1", 0)))

    @property
    def place(self) -> tuple[str, int]:
        return ("127.0.0.1", int(self.listener.getsockname()[1]))

    def serve(self) -> None:
        for is_good, answer in self.answers:
            connection, _ = self.listener.accept()
            with closing(connection), connection.makefile("rb") as incoming:
                header = self.read(incoming)
                connection.sendall(block(block(b"md5sum=1")))
                self.asked.append((header, self.read(incoming)))
                connection.sendall(is_good + block(answer))

    @staticmethod
    def read(incoming: Any) -> bytes:
        (length,) = struct.unpack("<I", incoming.read(4))
        return bytes(incoming.read(length))


@pytest.fixture
def nodelets(
    script: Callable[[str], ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> ModuleType:
    """The script, which does not wait between tries."""
    made = script("nodelets")
    monkeypatch.setattr(script("progress"), "FILES", (str(tmp_path / "progress"),))
    monkeypatch.setattr(script("loading"), "DELAYS", (0.0,))
    monkeypatch.setattr(script("loading"), "PAUSE", 0.0)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    return made


@pytest.fixture
def serve() -> Iterator[Callable[..., Manager]]:
    """Start a manager with its answers."""
    threads: list[threading.Thread] = []
    managers: list[Manager] = []

    def start(*answers: tuple[bytes, bytes]) -> Manager:
        managers.append(Manager(list(answers)))
        threads.append(threading.Thread(target=managers[-1].serve, daemon=True))
        threads[-1].start()
        return managers[-1]

    yield start
    for manager, thread in zip(managers, threads, strict=True):
        thread.join(5)
        manager.listener.close()


def load(nodelets: ModuleType, manager: Manager, *components: dict[str, Any]) -> list[Any]:
    """Load nodelets into a manager; return the parameters that were set."""
    asked = nodelets.Manager("/manager")
    found: list[Any] = []
    asked.find = lambda: setattr(asked, "place", manager.place)
    nodelets.ServerProxy = lambda uri: SimpleNamespace(
        setParam=lambda caller, name, value: found.append((name, value))
    )
    plan = {"node": "/manager", "components": components or (COMPONENT,)}
    with NamedTemporaryFile("w") as file:
        json.dump(plan, file)
        file.flush()
        nodelets.load_file(file.name, {"/manager": asked}.__getitem__)
    return found


def test_a_request_says_what_to_load(nodelets: ModuleType, serve: Callable[..., Manager]) -> None:
    """Name, type, and both sides of the remappings; no arguments and no bond."""
    manager = serve(GRANTED)
    assert load(nodelets, manager) == [("/robot/eye", {"rate": 2})]
    header, request = manager.asked[0]
    assert block(b"service=/manager/load_nodelet") in header
    one = struct.pack("<I", 1)
    names = [block(b"/robot/eye"), block(b"car/Eye")]
    renamed = [one + block(b"/robot/image"), one + block(b"/image")]
    assert request == b"".join([*names, *renamed, bytes(4), bytes(4)])


def test_a_refused_nodelet_is_tried_again_and_told(
    nodelets: ModuleType,
    serve: Callable[..., Manager],
    script: Callable[[str], ModuleType],
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The manager's own words are the cause, where it has any; the next nodelet waits."""
    manager = serve(FAILED, REFUSED, GRANTED, GRANTED)
    load(nodelets, manager, COMPONENT, {**COMPONENT, "name": "/ear"})
    log = capsys.readouterr().out
    what = "/manager cannot load /robot/eye (car/Eye)"
    assert f"{what} (attempt 1): no such plugin\n" in log
    assert f"{what} (attempt 2): see its log\n" in log
    assert [b"/ear" in request for _, request in manager.asked] == [False, False, False, True]
    line = "/manager has loaded /robot/eye, /ear"
    assert script("progress").describe("nodelets.py", "/manager") == (True, line)


def test_parameters_that_cannot_be_set_are_told(nodelets: ModuleType) -> None:
    """No master is there, or a value does not fit into XML-RPC."""
    asked = nodelets.Manager("/manager")
    what = "parameters of /robot/eye cannot be set: "
    with pytest.raises(nodelets.NotYet, match=f"{what}.*refused"):
        asked.set_parameters(COMPONENT)
    with pytest.raises(nodelets.NotYet, match=f"{what}int exceeds XML-RPC limits"):
        asked.set_parameters({**COMPONENT, "parameters": {"rate": 2**40}})


def test_only_a_manager_of_this_container_is_asked(
    nodelets: ModuleType, serve: Callable[..., Manager], monkeypatch: pytest.MonkeyPatch
) -> None:
    """While a pod is replaced, the master has the old pod's manager under the name."""
    manager = serve()
    host, port = manager.place
    monkeypatch.setenv("ROS_IP", host)
    found = {"code": "1", "uri": f"rosrpc://10.9.9.9:{port}"}

    class Master:
        def __init__(self, *_: Any) -> None:
            pass

        def call(self, *_: str) -> tuple[str, str, str]:
            return found["code"], "", found["uri"]

        def close(self) -> None:
            pass

    monkeypatch.setattr(nodelets, "Api", Master)
    asked = nodelets.Manager("/manager")
    with pytest.raises(nodelets.NotYet, match="of another pod"):
        asked.find()
    found["uri"] = f"rosrpc://{host}:1"
    with pytest.raises(nodelets.NotYet, match="of another pod"):
        asked.find()
    found["code"] = "-1"
    with pytest.raises(nodelets.NotYet, match="has no service /manager/load_nodelet"):
        asked.find()


@pytest.mark.programs
def test_python2_makes_the_same_request(nodelets: ModuleType, python2: str) -> None:
    """JSON gives it text of another type."""
    code = (
        "import json, sys, nodelets\n"
        "found = nodelets.make_request(json.loads(sys.argv[1]))\n"
        "sys.stdout.write(repr(bytearray(found)))"
    )
    done = subprocess.run(
        [python2, "-B", "-c", code, json.dumps(COMPONENT)],
        cwd=ROOM,
        capture_output=True,
        text=True,
    )
    assert done.stdout == repr(bytearray(nodelets.make_request(COMPONENT))), done.stderr

"""ready.py under the Pythons that ROS images have; the graph itself is tests/ros1's matter."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest

import rigel_inpod

pytestmark = pytest.mark.programs

READY = Path(rigel_inpod.__file__).parent / "ready.py"


class Handler(SimpleXMLRPCRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        pass


class Graph:
    """A master and the one node that it knows, both at one address, in this process."""

    def __init__(self, uri: str) -> None:
        self.uri = uri

    def getPid(self, caller: str) -> list[object]:
        return [1, "", 1]

    def lookupNode(self, caller: str, name: str) -> list[object]:
        return [1, "", self.uri] if name == "/talker_7_1" else [-1, "unknown node", ""]

    def getSystemState(self, caller: str) -> list[object]:
        return [1, "", [[["/rosout", ["/other", "/talker_7_1"]]], [], []]]

    def getParam(self, caller: str, key: str) -> list[object]:
        return [1, "", "run & run"]


@pytest.fixture
def uri() -> Iterator[str]:
    with SimpleXMLRPCServer(("127.0.0.1", 0), requestHandler=Handler) as server:
        found = f"http://127.0.0.1:{server.server_address[1]}/"
        server.register_instance(Graph(found))
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield found
        server.shutdown()
        thread.join()


@pytest.fixture(params=["2.7", "3"])
def python(request: pytest.FixtureRequest) -> str:
    return request.getfixturevalue("python2") if request.param == "2.7" else sys.executable


@pytest.mark.parametrize(
    ("kind", "line"),
    [("node", "ready: /talker_7_1\n"), ("master", "ready: ROS master at port {port}\n")],
)
def test_ready(python: str, uri: str, kind: str, line: str, tmp_path: Path):
    """The whole way of a probe works, with the flags that ready.sh gives."""
    done = subprocess.run(
        [python, "-S", "-E", "-B", str(READY), kind],
        capture_output=True,
        text=True,
        env={"ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "TMPDIR": str(tmp_path)},
    )
    port = uri.rstrip("/").rpartition(":")[2]
    assert (done.stdout, done.stderr) == (line.format(port=port), "")
    assert done.returncode == 0

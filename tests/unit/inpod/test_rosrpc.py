"""The probe's small XML-RPC against the standard library's, as the other side of the wire."""

from __future__ import annotations

import importlib.util
import socket
import threading
import time
import xmlrpc.client
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from xmlrpc.server import SimpleXMLRPCRequestHandler, SimpleXMLRPCServer

import pytest

import rigel_inpod

VALUES = [
    "",
    "plain",
    "a<b & c>d \"e\" 'f'",
    "Größe",
    "two\nlines",
    [],
    [["/chatter", ["/talker", "/b"]], ["/x", []]],
    [[], [[]], ["a"]],
]


@pytest.fixture(scope="module")
def rosrpc() -> ModuleType:
    """The module as it is mounted; it belongs to no package there."""
    path = Path(rigel_inpod.__file__).parent / "rosrpc.py"
    spec = importlib.util.spec_from_file_location("rosrpc", path)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Handler(SimpleXMLRPCRequestHandler):
    """Quiet, and keeps connections as rosmaster does."""

    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture(params=["HTTP/1.1", "HTTP/1.0"])
def server(request: pytest.FixtureRequest) -> Iterator[str]:
    """A server with one method, echo; yields its URI."""
    handler = type("Own", (Handler,), {"protocol_version": request.param})
    with SimpleXMLRPCServer(("127.0.0.1", 0), requestHandler=handler) as found:
        found.register_function(lambda caller, *words: [1, "ok", list(words)], "echo")
        thread = threading.Thread(target=found.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield f"http://127.0.0.1:{found.server_address[1]}"
        found.shutdown()
        thread.join()


@pytest.mark.parametrize("value", VALUES, ids=repr)
def test_answer(rosrpc: ModuleType, value: object):
    """What another implementation writes is read as it was meant."""
    text = xmlrpc.client.dumps(([1, "", value],), methodresponse=True)
    assert rosrpc.parse(text) == ["1", "", value]


def test_roscpp_answer(rosrpc: ModuleType):
    """roscpp writes <i4>, and text without <string>."""
    words = "<value><i4>1</i4></value><value></value><value>http://a:1/</value>"
    text = f"<?xml?><methodResponse><params><param><value><array><data>{words}</data></array>"
    answer = rosrpc.parse(text + "</value></param></params></methodResponse>")
    assert answer == ["1", "", "http://a:1/"]


def test_calls(rosrpc: ModuleType, server: str):
    """Several calls on one connection (or on a new one each, where the server closes it)."""
    api = rosrpc.Api(server, time.time() + 60)
    for word in ("first", "a<b&c", "third"):
        assert api.call("echo", word) == ["1", "ok", [word]]
    api.close()


def test_fault(rosrpc: ModuleType, server: str):
    """A method that the server does not have is a failed call."""
    api = rosrpc.Api(server, time.time() + 60)
    with pytest.raises(rosrpc.CallFailed, match="fault"):
        api.call("nothing")
    api.close()


def test_refused(rosrpc: ModuleType):
    """Nobody listens: said in the system's words, without its numbers."""
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        uri = f"http://127.0.0.1:{unused.getsockname()[1]}"
        with pytest.raises(rosrpc.CallFailed, match=r"^Connection refused$"):
            rosrpc.Api(uri, time.time() + 60).call("getPid")


def test_silent(rosrpc: ModuleType):
    """A server that accepts and says nothing costs the deadline."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        api = rosrpc.Api(f"http://127.0.0.1:{silent.getsockname()[1]}", time.time() + 0.2)
        with pytest.raises(rosrpc.CallFailed, match=r"^timed out$"):
            api.call("getPid")


@pytest.mark.parametrize(
    "uri", ["", "ros-master:11311", "http://ros-master", "http://:1", "x://a:1"]
)
def test_bad_uri(rosrpc: ModuleType, uri: str):
    """What is not http://HOST:PORT is told as that."""
    with pytest.raises(rosrpc.CallFailed, match="is not http://HOST:PORT"):
        rosrpc.Api(uri, time.time() + 1)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        (b"HTTP/1.1 200 OK\r\nContent-Length: 4000000000\r\n\r\n", "too large"),
        (b"HTTP/1.1 200 OK\r\nX: " + 17 * 2**20 * b"x", "too large"),
    ],
)
def test_an_endless_answer_is_not_read(rosrpc: ModuleType, answer: bytes, why: str) -> None:
    """A probe has the memory of the node's own container."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with server.accept()[0] as link, suppress(OSError):
                link.recv(65536)
                link.sendall(answer)
                link.recv(65536)

        thread = threading.Thread(target=serve)
        thread.start()
        api = rosrpc.Api(f"http://127.0.0.1:{server.getsockname()[1]}", time.time() + 60)
        with pytest.raises(rosrpc.CallFailed, match=why):
            api.call("getPid")
        thread.join()


def test_an_answer_of_many_levels_is_refused(rosrpc: ModuleType) -> None:
    """Python's own limit would end a whole look at the graph, far from its cause."""
    levels = 1000
    text = "<array><data><value>" * levels + "</value></data></array>" * levels
    with pytest.raises(rosrpc.CallFailed, match="too deep"):
        rosrpc.parse(f"<methodResponse><value>{text}</value></methodResponse>")


def test_a_connection_that_the_server_has_closed_is_opened_again(rosrpc: ModuleType) -> None:
    """rosmaster ends idle ones without a word."""
    body = xmlrpc.client.dumps(([1, "", "x"],), methodresponse=True).encode()
    answer = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % len(body) + body
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve() -> None:
            for _ in range(2):
                connection, _ = listening.accept()
                with connection:
                    connection.recv(65536)
                    connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        api = rosrpc.Api(f"http://127.0.0.1:{listening.getsockname()[1]}", time.time() + 60)
        assert [api.call("getPid")[2] for _ in range(2)] == ["x", "x"]
        thread.join()
        api.close()

"""Commands in a container and forwarded ports, against the other end of the websocket."""

from __future__ import annotations

import fcntl
import io
import json
import os
import pty
import socket
import struct
import termios
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, NotFoundError, UserError
from rigel_k8s.kube import execution, forwarding, websocket
from rigel_k8s.kube.failures import Forbidden, Garbled
from rigel_k8s.kube.target import Credentials
from tests.support.http_server import Exchange
from tests.support.websocket import Channels

STDIN, STDOUT, STDERR, RESULT, RESIZE, CLOSE = 0, 1, 2, 3, 4, 255
POD = ("robot", "talker")
SUCCESS = b'{"status": "Success"}'


def failure(code: int) -> bytes:
    causes = [{"reason": "ExitCode", "message": str(code)}]
    return json.dumps({"status": "Failure", "details": {"causes": causes}}).encode()


def read_input(channels: Channels) -> bytes:
    """Return the whole standard input, until the client closes it."""
    got = b""
    while (frame := channels.receive()) is not None:
        channel, data = frame
        if channel == CLOSE:
            assert data == bytes([STDIN])
            return got
        if channel == STDIN:
            got += data
    raise AssertionError("the client left without closing its input")


def test_a_command_gets_its_input_and_leaves_output_and_exit_code(serve: Any) -> None:
    """Both outputs, apart; an input longer than a frame, with its end; what the server is asked."""

    def answer(exchange: Exchange) -> None:
        channels = Channels(exchange)
        channels.send(STDERR, b"wrong\n")
        channels.send(STDOUT, b"%d" % len(read_input(channels)))
        channels.send(STDOUT, b" bytes")
        channels.send(RESULT, failure(3))
        channels.close()

    cluster, server = serve(answer)
    done = cluster.run(*POD, ["wc", "-c"], container="node", stdin=b"x" * 100_000)
    assert (done.code, done.stdout, done.stderr) == (3, b"100000 bytes", b"wrong\n")
    [request] = server.requests
    assert str(request) == "GET /api/v1/namespaces/robot/pods/talker/exec"
    assert request.query == {
        "command": ["wc", "-c"],
        "container": ["node"],
        "stdin": ["true"],
        "stdout": ["true"],
        "stderr": ["true"],
    }
    assert request.headers["Sec-WebSocket-Protocol"] == "v5.channel.k8s.io,v4.channel.k8s.io"


def test_an_older_server_is_sent_no_end_of_input(serve: Any) -> None:
    """Protocol v4 has no word for it, and would take it for input."""
    got = []

    def answer(exchange: Exchange) -> None:
        channels = Channels(exchange, "v4.channel.k8s.io")
        got.append(channels.receive())
        channels.send(RESULT, SUCCESS)
        channels.close()
        while (frame := channels.receive()) is not None:
            got.append(frame)

    cluster, server = serve(answer)
    assert cluster.run(*POD, ["head", "-1"], stdin=b"line\n").code == 0
    assert server.closed.acquire(timeout=10)
    assert got == [(STDIN, b"line\n")]


def end_with(*frames: tuple[int, bytes]) -> Any:
    def answer(exchange: Exchange) -> None:
        channels = Channels(exchange)
        for frame in frames:
            channels.send(*frame)
        channels.close()

    return answer


def test_a_command_that_does_not_end_is_an_error_in_time(
    serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With what it has said meanwhile."""
    # The deadline is set; a minute for the first frame, a tenth of a second for the next; over.
    clock = iter([0.0, 0.0, 59.9, 60.0])
    monkeypatch.setattr(execution, "time", SimpleNamespace(monotonic=clock.__next__))
    over = threading.Event()

    def answer(exchange: Exchange) -> None:
        Channels(exchange).send(STDERR, b"waiting for the master\n")
        over.wait(60)

    cluster, _ = serve(answer)
    with pytest.raises(
        ClusterError, match=r"rosnode in Pod robot/talker did not end within 60 s"
    ) as caught:
        cluster.run(*POD, ["rosnode", "ping"], timeout=60)
    over.set()
    assert caught.value.details == ("waiting for the master",)


def test_a_connection_that_breaks_is_no_success(serve: Any) -> None:
    """The pod was deleted, perhaps: nobody knows what the command did."""
    cluster, _ = serve(end_with((STDOUT, b"half")))
    with pytest.raises(ClusterError, match="ended before the command did"):
        cluster.run(*POD, ["true"])


def test_a_command_that_cannot_be_started_says_why(serve: Any) -> None:
    """In the container runtime's words."""
    status = {"status": "Failure", "message": "executable file not found"}
    cluster, _ = serve(end_with((RESULT, json.dumps(status).encode())))
    with pytest.raises(ClusterError, match="cannot run the command in"):
        cluster.run(*POD, ["no-such-command"])


@pytest.mark.parametrize(("status", "error"), [(403, Forbidden), (404, NotFoundError)])
def test_a_refused_websocket_is_the_servers_own_error(serve: Any, status: int, error: Any) -> None:
    """Not a failed connection; and the server was told who asks."""
    me = Credentials("", "", lambda *, fresh: [("Impersonate-User", "ann")])
    cluster, server = serve(
        lambda exchange: exchange.say(status, {"message": "no such right"}), credentials=lambda: me
    )
    with pytest.raises(error, match="cannot run true in Pod robot/talker: no such right"):
        cluster.run(*POD, ["true"])
    assert server.requests[0].headers["Impersonate-User"] == "ann"


@pytest.mark.parametrize("body", [b"", b"7", b"<html>", b"\xff"])
def test_what_is_no_websocket_is_an_answer_that_cannot_be_understood(
    serve: Any, body: bytes
) -> None:
    """A login page says 200."""
    client, _ = serve(lambda exchange: exchange.say(200, body))
    with pytest.raises(Garbled, match="it is not a websocket"):
        client.run("n", "p", ["x"])


def test_a_head_that_is_no_text_is_no_websocket(serve: Any) -> None:
    """Bytes that are not UTF-8."""

    def answer(exchange: Exchange) -> None:
        exchange.wfile.write(b"HTTP/1.1 \xff\xfe\r\n\r\n")
        exchange.hang_up()

    client, _ = serve(answer)
    with pytest.raises(ClusterError):
        client.run("n", "p", ["x"])


# Streams and terminals.


@contextmanager
def pipe(data: bytes = b"") -> Iterator[Any]:
    """A pipe with some bytes in it, whose other end stays open unless there are some."""
    reading, writing = os.pipe()
    os.write(writing, data)
    if data:
        os.close(writing)
    with open(reading, "rb", buffering=0) as stream:  # noqa: PTH123  a descriptor, no path
        yield stream
    if not data:
        os.close(writing)


def test_streams_are_carried_both_ways(serve: Any) -> None:
    """The caller's input with its end, the command's outputs, its exit code."""

    def answer(exchange: Exchange) -> None:
        channels = Channels(exchange)
        channels.send(STDOUT, read_input(channels).upper())
        channels.send(STDERR, b"done")
        channels.send(RESULT, failure(5))
        channels.close()

    cluster, _ = serve(answer)
    out, err = io.BytesIO(), io.BytesIO()
    with pipe(b"some words") as stdin:
        assert cluster.exec(*POD, ["x"], stdin=stdin, stdout=out, stderr=err) == 5
    assert (out.getvalue(), err.getvalue()) == (b"SOME WORDS", b"done")


def test_a_command_that_ends_does_not_wait_for_more_input(serve: Any) -> None:
    """A terminal has no end."""
    cluster, server = serve(end_with((RESULT, SUCCESS)))
    out, started = io.BytesIO(), time.monotonic()
    with pipe() as stdin:
        assert cluster.exec(*POD, ["x"], stdin=stdin, stdout=out, stderr=out) == 0
    assert time.monotonic() - started < 10
    assert cluster.exec(*POD, ["x"], stdout=out, stderr=out) == 0
    assert "stdin" not in server.requests[1].query


def test_a_terminal_is_raw_meanwhile_and_then_as_it_was(serve: Any) -> None:
    """The command learns its size; standard error comes with the output."""
    sizes, modes = [], []
    outer, inner = pty.openpty()
    fcntl.ioctl(inner, termios.TIOCSWINSZ, struct.pack("HHHH", 33, 77, 0, 0))
    before = termios.tcgetattr(inner)

    def answer(exchange: Exchange) -> None:
        channels = Channels(exchange)
        frame = channels.receive()
        assert frame is not None
        sizes.append((frame[0], json.loads(frame[1])))
        modes.append(termios.tcgetattr(inner))
        channels.send(RESULT, SUCCESS)
        channels.close()

    cluster, server = serve(answer)
    out = io.BytesIO()
    with open(inner, "rb", buffering=0) as stdin:  # noqa: PTH123  a descriptor, no path
        assert cluster.exec(*POD, ["sh"], stdin=stdin, stdout=out, stderr=out, tty=True) == 0
        assert termios.tcgetattr(inner) == before
    os.close(outer)
    assert sizes == [(RESIZE, {"Width": 77, "Height": 33})]
    assert not modes[0][3] & (termios.ICANON | termios.ECHO)
    assert server.requests[0].query["tty"] == ["true"]
    assert "stderr" not in server.requests[0].query


# Ports.

DATA, ERROR = 0, 1


def greet(channels: Channels, port: int) -> None:
    """Both channels begin with the port's number."""
    for channel in (DATA, ERROR):
        channels.send(channel, struct.pack("<H", port))


def ask(port: int, data: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=10) as connection:
        connection.sendall(data)
        got = b""
        while part := connection.recv(100):
            got += part
        return got


def test_a_port_is_forwarded_by_a_websocket_for_each_connection(serve: Any) -> None:
    """Bytes as they are, in both directions; afterwards nothing listens any more."""

    def answer(exchange: Exchange) -> None:
        channels = Channels(exchange)
        greet(channels, 7000)
        frame = channels.receive()
        assert frame is not None
        channels.send(DATA, b"you said " + frame[1])
        channels.close()

    cluster, server = serve(answer)
    with cluster.port_forward(*POD, {7000: 0}) as forward:
        port = forward.ports[7000]
        assert ask(port, b"\x00one") == b"you said \x00one"
        assert ask(port, b"two") == b"you said two"
        assert forward.errors == []
        with pytest.raises(UserError, match="cannot listen"):
            cluster.port_forward(*POD, {1: port}).__enter__()
    with pytest.raises(OSError, match="refused"):
        socket.create_connection(("127.0.0.1", port), timeout=5)
    assert [request.query for request in server.requests] == [{"ports": ["7000"]}] * 2
    assert server.list_requests()[0] == "GET /api/v1/namespaces/robot/pods/talker/portforward"


def test_what_went_wrong_with_a_port_is_kept(serve: Any) -> None:
    """A port that nobody listens on, a pod that is gone: the next connection may work."""

    def answer(exchange: Exchange) -> None:
        if len(exchange.server.requests) > 1:
            exchange.say(404, {"message": "pods talker not found"})
            return
        channels = Channels(exchange)
        greet(channels, 7000)
        channels.send(ERROR, b"connection refused")

    cluster, _ = serve(answer)
    with cluster.port_forward(*POD, {7000: 0}) as forward:
        assert ask(forward.ports[7000], b"x") == b""
        assert forward.errors == ["connection refused"]
        assert ask(forward.ports[7000], b"") == b""
        assert "pods talker not found" in forward.errors[1]


@pytest.mark.parametrize(
    ("message", "ground"),
    [
        ('pods "talker" is forbidden: User "ann" cannot get resource "pods/portforward"', "right"),
        ('admission webhook "calm" denied the request: not now', None),
    ],
)
def test_a_missing_right_to_forward_is_kept_apart(
    serve: Any, message: str, ground: str | None
) -> None:
    """Each connection would be refused; what else is wrong may be over with the next one."""
    cluster, _ = serve(lambda exchange: exchange.say(403, {"kind": "Status", "message": message}))
    with cluster.port_forward(*POD, {7000: 0}) as forward:
        assert ask(forward.ports[7000], b"") == b""
        assert message in forward.errors[0]
        assert (forward.denied and forward.denied.ground) == ground


def test_an_answer_may_come_after_the_last_byte_of_the_question(
    serve: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A client that says no more still listens; a websocket cannot be closed by half."""
    lingers = threading.Event()  # we have seen the end of the question

    class Over(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            assert timeout == forwarding.LINGER
            lingers.set()
            return super().wait(timeout)

    threads = SimpleNamespace(Event=Over, Thread=threading.Thread)
    monkeypatch.setattr(forwarding, "threading", threads)

    def answer(exchange: Exchange) -> None:
        channels = Channels(exchange)
        greet(channels, 7000)
        channels.receive()
        assert lingers.wait(60)
        channels.send(DATA, b"late")
        channels.close()

    cluster, _ = serve(answer)
    with cluster.port_forward(*POD, {7000: 0}) as forward:
        address = ("127.0.0.1", forward.ports[7000])
        with socket.create_connection(address, timeout=60) as connection:
            connection.sendall(b"x")
            connection.shutdown(socket.SHUT_WR)
            assert connection.recv(100) == b"late"


def test_another_thread_ends_a_websocket_and_leaves_its_socket_to_its_owner(serve: Any) -> None:
    """Closed by the other one, its number could be the next connection's while it is read."""

    def answer(exchange: Exchange) -> None:
        Channels(exchange).receive()

    cluster, _ = serve(answer)
    with websocket.connect(cluster.client, "/x", "test", ["v5"]) as session:
        connection = session.inner.sock
        other = threading.Thread(target=session.abort)
        other.start()
        other.join()
        assert connection.fileno() >= 0
        assert session.receive(None) is None
    assert connection.fileno() == -1

"""The gate's doors and its ways out, on real sockets."""

from __future__ import annotations

import asyncio
import random
import socket
import struct
import threading
import xmlrpc.client
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from typing import Any
from unittest.mock import AsyncMock, Mock, patch

import pytest

from rigel_gate import http
from rigel_gate.calls import Answer, BadCall, Call
from rigel_gate.context import Context
from rigel_gate.http import IDLE, MOST_OF_ONE, Callers, Door, HttpLinks, place_of
from rigel_gate.links import MasterGone, NodeGone, NodeSilent
from rigel_gate.nodes import Nodes
from rigel_gate.state import State

LOCAL = "127.0.0.1"
BODY = Call("echo", ("/me", "hello")).body
Answering = Callable[[Call, str], Coroutine[Any, Any, Answer]]


async def echo(call: Call, host: str) -> Answer:
    return Answer([1, call.method, list(call.params)])


def request(body: bytes = BODY, *, line: str = "POST /RPC2 HTTP/1.1", head: str = "") -> bytes:
    return f"{line}\r\n{head}Content-Length: {len(body)}\r\n\r\n".encode() + body


class Clock:
    """A clock that stands still until a test moves it on; what is due then is called."""

    def __init__(self) -> None:
        self.now = 1000.0
        self.waiting: list[tuple[float, Callable[[], object]]] = []

    def time(self) -> float:
        return self.now

    def call_later(self, delay: float, callback: Callable[[], object]) -> Any:
        one = (self.now + delay, callback)
        self.waiting.append(one)
        return Mock(cancel=lambda: one in self.waiting and self.waiting.remove(one))

    def move(self, seconds: float) -> None:
        self.now += seconds
        due = [one for one in self.waiting if one[0] <= self.now]
        self.waiting = [one for one in self.waiting if one[0] > self.now]
        for _, callback in due:
            callback()


async def until(condition: Callable[[], object]) -> None:
    """Wait for a state of the server; a test that waits in vain fails after a minute."""
    while not condition():
        await asyncio.sleep(0.001)


@asynccontextmanager
async def door(
    answering: Answering = echo, clock: Clock | None = None, log: Callable[[str], None] = print
) -> AsyncIterator[int]:
    """Open a door; its port."""
    callers = Callers(log, clock or Clock())
    server = await asyncio.start_server(Door(answering, callers).serve, LOCAL, 0)
    async with server:
        yield server.sockets[0].getsockname()[1]


@asynccontextmanager
async def caller(
    port: int,
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    """Connect to a door."""
    reader, writer = await asyncio.open_connection(LOCAL, port)
    yield reader, writer
    writer.close()


async def read_answer(reader: asyncio.StreamReader) -> tuple[str, Any]:
    """Return the head of an answer, and its value."""
    head = (await reader.readuntil(b"\r\n\r\n")).decode()
    length = int(head.lower().partition("content-length:")[2].split()[0])
    body = await reader.readexactly(length)
    return head, Answer(body=body).value if body else None


def run(work: Coroutine[Any, Any, None]) -> None:
    """Run a test's coroutine; what asyncio reports of callbacks fails it."""
    troubles: list[dict[str, Any]] = []

    async def watched() -> None:
        asyncio.get_running_loop().set_exception_handler(
            lambda _, trouble: troubles.append(trouble)
        )
        await asyncio.wait_for(work, 60)
        await asyncio.sleep(0.01)  # until both ends of each connection are closed

    asyncio.run(watched())
    assert troubles == []


# -- the door --


def test_a_connection_is_kept_for_further_calls():
    """rospy and roscpp make all their calls by one."""

    async def work() -> None:
        async with door() as port, caller(port) as (reader, writer):
            for _ in range(3):
                writer.write(request())
                head, value = await read_answer(reader)
                assert head.startswith("HTTP/1.1 200 OK\r\n")
                assert "Content-Type: text/xml" in head
                assert "close" not in head
                assert value == [1, "echo", ["/me", "hello"]]

    run(work())


@pytest.mark.parametrize(
    ("line", "head", "stays"),
    [
        ("POST /RPC2 HTTP/1.0", "", False),
        ("POST /RPC2 HTTP/1.0", "Connection: keep-alive\r\n", True),
        ("POST / HTTP/1.1", "connection: Close\r\n", False),
        ("POST / HTTP/1.1", "X-Connection: close\r\n", True),
    ],
)
def test_who_wants_no_more_gets_a_connections_end(line: str, head: str, *, stays: bool):
    """HTTP/1.0, and `Connection: close`."""

    async def work() -> None:
        async with door() as port, caller(port) as (reader, writer):
            writer.write(request(line=line, head=head))
            answered, _ = await read_answer(reader)
            assert ("Connection: close" in answered) is not stays
            if stays:
                writer.write(request())
                await read_answer(reader)
            else:
                assert await reader.read() == b""

    run(work())


def test_a_call_may_come_byte_by_byte():
    """In as many packets as it has bytes, with the next one behind it."""

    async def work() -> None:
        async with door() as port, caller(port) as (reader, writer):
            for byte in request() + request():
                writer.write(bytes([byte]))
                await asyncio.sleep(0)
            for _ in range(2):
                assert (await read_answer(reader))[1][0] == 1

    run(work())


def test_calls_of_a_connection_are_answered_one_after_the_other():
    """A caller that sends three at once gets three answers, in their order."""
    busy = []

    async def slow(call: Call, host: str) -> Answer:
        busy.append(call)
        assert len(busy) == 1
        await asyncio.sleep(0.01)
        busy.remove(call)
        return Answer([1, call.method, 0])

    async def work() -> None:
        async with door(slow) as port, caller(port) as (reader, writer):
            writer.write(b"".join(request(Call(f"m{n}", ()).body) for n in range(3)))
            assert [(await read_answer(reader))[1][1] for _ in range(3)] == ["m0", "m1", "m2"]

    run(work())


@pytest.mark.parametrize(
    ("sent", "status"),
    [
        (b"GET / HTTP/1.1\r\n\r\n", "501"),
        (b"nonsense\r\n\r\n", "501"),
        (b"POST / HTTP/1.1\r\nContent-Length: many\r\n\r\n", "411"),
        ("POST / HTTP/1.1\r\nContent-Length: ²\r\n\r\n".encode("latin-1"), "411"),
        (b"POST / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", "411"),
        (b"POST / HTTP/1.1\r\nContent-Length: 999999999999\r\n\r\n", "501"),
        (b"POST / HTTP/1.1\r\nContent-Length: " + 10000 * b"9" + b"\r\n\r\n", "411"),
        (f"POST / HTTP/1.1\r\nContent-Length: {http.LARGEST_BODY + 1}\r\n\r\n".encode(), "501"),
        (b"POST / HTTP/1.1\r\nX: " + 70000 * b"x", "431"),
    ],
)
def test_what_is_no_request_is_refused(sent: bytes, status: str):
    """And its connection ends: no one knows where the next request would begin."""

    async def work() -> None:
        async with door() as port, caller(port) as (reader, writer):
            writer.write(sent)
            head = (await reader.readuntil(b"\r\n\r\n")).decode()
            assert head.startswith(f"HTTP/1.1 {status} ")
            assert await reader.read() == b""

    run(work())


@pytest.mark.parametrize("body", [b"", b"no XML", b"<methodName>m</methodName>&"])
def test_what_is_no_call_gets_a_fault(body: bytes):
    """The connection goes on: it was a request."""

    async def work() -> None:
        async with door() as port, caller(port) as (reader, writer):
            writer.write(request(body))
            assert (await read_answer(reader))[1][0] == -1
            writer.write(request())
            assert (await read_answer(reader))[1][0] == 1

    run(work())


@pytest.mark.parametrize("value", [ZeroDivisionError("bug"), Answer([1, "", 2**40])])
def test_a_failure_of_the_gate_is_a_fault(value: Any):
    """No caller waits for ever: an exception, and what XML-RPC cannot carry."""

    async def fail(call: Call, host: str) -> Answer:
        if isinstance(value, Exception):
            raise value
        return value  # type: ignore[no-any-return]

    async def work() -> None:
        async with door(fail) as port, caller(port) as (reader, writer):
            for _ in range(2):
                writer.write(request())
                code, message, _ = (await read_answer(reader))[1]
                assert code == -1
                assert "the gate failed" in message

    run(work())


def test_a_call_whose_caller_hangs_up_is_carried_out():
    """A node that ends unregisters without waiting."""
    done = asyncio.Event()

    async def slow(call: Call, host: str) -> Answer:
        await asyncio.sleep(0.05)
        done.set()
        return Answer([1, "", 0])

    async def work() -> None:
        async with door(slow) as port:
            async with caller(port) as (_, writer):
                writer.write(request())
                await asyncio.sleep(0.02)
            await done.wait()

    run(work())


def test_a_connection_that_is_reset_before_it_is_taken_leaves_the_door_open():
    """The address of such a caller is not known any more."""

    async def work() -> None:
        async with door() as port:
            with socket.create_connection((LOCAL, port)) as hasty:
                hasty.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            await asyncio.sleep(0.05)
            async with caller(port) as (reader, writer):
                writer.write(request())
                assert (await read_answer(reader))[1][0] == 1

    run(work())


def test_a_call_brings_the_address_that_it_came_from():
    """It is the loopback for a call from this pod."""
    seen = []

    async def note(call: Call, host: str) -> Answer:
        seen.append(host)
        return Answer([1, "", 0])

    async def work() -> None:
        async with door(note) as port, caller(port) as (reader, writer):
            writer.write(request())
            await read_answer(reader)
        reader = asyncio.StreamReader()
        reader.feed_data(request())
        reader.feed_eof()
        far = Mock(get_extra_info=lambda _: ("10.1.0.3", 40000), drain=AsyncMock())
        far.transport.get_write_buffer_size.return_value = 0
        await Door(note, Callers(print, Clock())).serve(reader, far)

    run(work())
    assert seen == [LOCAL, "10.1.0.3"]


# -- callers that take more than their part --


def test_what_follows_a_call_is_not_read_before_its_answer():
    """However much a caller sends: the machine's buffers hold it, and not the gate."""
    going, asked = asyncio.Event(), []

    async def wait(call: Call, host: str) -> Answer:
        asked.append(call)
        await going.wait()
        return Answer([1, "", 0])

    async def work() -> None:
        served = []

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            served.append((reader, writer))
            await Door(wait, Callers(print, Clock())).serve(reader, writer)

        async with await asyncio.start_server(serve, LOCAL, 0) as listening:
            port = listening.sockets[0].getsockname()[1]
            async with caller(port) as (reader, writer):
                writer.write(request())
                await until(lambda: asked)
                writer.write(request(BODY + b" " * 8 * 2**20))
                transport: Any = served[0][1].transport
                await until(lambda: not transport.is_reading())
                assert 0 < len(served[0][0]._buffer) < 2**20  # type: ignore[attr-defined]
                going.set()
                for _ in range(2):
                    await read_answer(reader)
        assert len(asked) == 2

    run(work())


def test_answers_that_no_one_reads_are_not_made():
    """A caller that only asks is answered as far as it reads, and in full once it does."""
    asked = []

    async def large(call: Call, host: str) -> Answer:
        asked.append(call)
        return Answer([1, "x" * 2**20, 0])

    async def work() -> None:
        served = []

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            served.append(writer)
            await Door(large, Callers(print, Clock())).serve(reader, writer)

        async with await asyncio.start_server(serve, LOCAL, 0) as listening:
            port = listening.sockets[0].getsockname()[1]
            async with caller(port) as (reader, writer):
                writer.write(request() * 100)
                await until(lambda: served and served[0].transport.get_write_buffer_size())
                made = -1
                while made != len(asked):  # the caller's own reader takes some answers at first
                    made = len(asked)
                    for _ in range(100):
                        await asyncio.sleep(0)
                assert len(asked) < 50
                for _ in range(100):
                    await read_answer(reader)

    run(work())


@pytest.mark.parametrize("sent", [b"", b"POST / HTTP/1.1\r\nContent-Le", request()[:-1]])
def test_a_caller_that_makes_no_call_is_not_waited_for(sent: bytes):
    """Half a head, half a body, nothing: its connection ends."""
    clock = Clock()

    async def work() -> None:
        async with door(clock=clock) as port, caller(port) as (reader, writer):
            writer.write(request() + sent)
            await read_answer(reader)
            await until(lambda: clock.waiting)
            clock.move(IDLE - 1)
            writer.write(b" ")  # it goes on, too slowly
            clock.move(1)
            with suppress(ConnectionResetError):
                assert await reader.read() == b""

    run(work())


def test_a_caller_that_waits_for_its_answer_is_not_idle():
    """A node may wait for a name, or for roscore, as long as it takes."""
    clock = Clock()

    async def slow(call: Call, host: str) -> Answer:
        clock.move(10 * IDLE)
        return Answer([1, "", 0])

    async def work() -> None:
        async with door(slow, clock) as port, caller(port) as (reader, writer):
            for _ in range(2):
                writer.write(request())
                assert (await read_answer(reader))[1][0] == 1

    run(work())


@pytest.mark.parametrize("piece", [http.LARGE, 2**25])
def test_a_last_answer_that_no_one_reads_ends_too(piece: int, monkeypatch: pytest.MonkeyPatch):
    """A caller that wants no more calls and does not read keeps no connection.

    Neither while the answer is sent, nor when all of it is on its way.
    """
    monkeypatch.setattr(http, "LARGE", piece)
    clock, writers = Clock(), []

    async def large(call: Call, host: str) -> Answer:
        return Answer([1, "x" * 2**24, 0])

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        await Door(large, Callers(print, clock)).serve(reader, writer)

    async def work() -> None:
        server = await asyncio.start_server(serve, LOCAL, 0)
        async with server, caller(server.sockets[0].getsockname()[1]) as (_, writer):
            writer.write(request(head="Connection: close\r\n"))
            await until(lambda: writers and writers[0].transport.get_write_buffer_size())
            await until(lambda: clock.waiting)
            assert writers[0].transport.is_closing() == (piece > 2**24)
            clock.move(IDLE)
            await until(lambda: not writers[0].transport.get_write_buffer_size())
            assert writers[0].transport.is_closing()

    run(work())


async def ask(port: int, sent: bytes) -> bytes:
    """Return what a new connection is answered in its first line, b"" for nothing."""
    async with caller(port) as (reader, writer):
        writer.write(sent)
        with suppress(ConnectionResetError):
            return (await reader.readline()).strip()
        return b""


PROBE = b"GET /ready HTTP/1.1\r\nHost: pod\r\n\r\n"


@asynccontextmanager
async def full_door(port: int) -> AsyncIterator[None]:
    """Open as many connections as an address may have, and one more, which is refused."""
    async with AsyncExitStack() as opened:
        for _ in range(MOST_OF_ONE):
            reader, writer = await opened.enter_async_context(caller(port))
        writer.write(request())  # the last one that is taken: the others are, too
        await read_answer(reader)
        yield


def test_one_address_has_no_more_than_its_connections():
    """What is above gets an answer that says so, and others as these end."""
    lines: list[str] = []

    async def work() -> None:
        async with door(log=lines.append) as port:
            async with full_door(port):
                assert await ask(port, request()) == b"HTTP/1.1 503 Service Unavailable"
                assert await ask(port, b"nonsense\r\n\r\n") == b"HTTP/1.1 503 Service Unavailable"
                assert await ask(port, b"\r\n\r\n") == b"HTTP/1.1 503 Service Unavailable"
            while await ask(port, request()) != b"HTTP/1.1 200 OK":
                await asyncio.sleep(0.001)

    run(work())
    assert lines == ["refused connections: 1 of 127.0.0.1; an address has at most 512"]


def test_a_probe_is_answered_beside_all_connections_of_its_address():
    """The kubelet's is the machine's: a program there must not make the master unready."""
    lines: list[str] = []

    async def work() -> None:
        async with door(log=lines.append) as port, full_door(port):
            assert await ask(port, PROBE) == b"HTTP/1.1 200 OK"

    run(work())
    assert lines == []


def test_a_connection_above_the_limit_has_to_be_a_probe_at_once():
    """One that says nothing does not stay; of too many not even that is waited for."""
    clock = Clock()

    async def work() -> None:
        async with door(clock=clock, log=lambda _: None) as port, full_door(port):
            idle = len(clock.waiting)
            async with caller(port) as (reader, writer):
                writer.write(b"GET /rea")
                await until(lambda: len(clock.waiting) == idle + 1)
                clock.move(http.HASTE)
                assert (await reader.readline()).startswith(b"HTTP/1.1 503 ")
            with patch.object(http, "MOST_GUESTS", 0):
                assert (await ask(port, PROBE)).startswith(b"HTTP/1.1 503 ")

    run(work())


def test_refused_connections_are_reported_once_a_minute():
    """With their addresses and their numbers; `describe` has them for a while."""
    lines: list[str] = []
    clock = Clock()
    callers = Callers(lines.append, clock)
    for host in ("10.0.0.1", "10.0.0.1", "10.0.0.1", "10.0.0.2"):
        callers.refuse(host)
    limit = "; an address has at most 512"
    assert lines == ["refused connections: 1 of 10.0.0.1" + limit]
    clock.move(59)
    assert len(lines) == 1
    clock.move(1)
    assert lines[1:] == ["refused connections: 2 of 10.0.0.1, 1 of 10.0.0.2" + limit]
    assert [note.split(", ")[0] for note in callers.list_notes()] == [
        "the gate has refused 3 connections of 10.0.0.1",
        "the gate has refused 1 connections of 10.0.0.2",
    ]
    clock.move(60)
    clock.move(60)
    assert len(lines) == 2
    assert clock.waiting == []
    callers.refuse("10.0.0.2")
    assert len(lines) == 3, "at once"
    clock.move(500)
    assert len(callers.list_notes()) == 1, "the other one has been left alone for ten minutes"
    clock.move(200)
    assert callers.list_notes() == []


def test_a_large_call_is_read_in_a_thread():
    """Others would wait for seconds meanwhile; small ones are read at once."""
    threads = []
    real = Call._read_params

    def note(self: Call) -> Any:
        threads.append(threading.current_thread())
        return real(self)

    async def work() -> None:
        async with door() as port, caller(port) as (reader, writer):
            for size in (10, http.LARGE):
                writer.write(request(Call("echo", ("/me", size * "x")).body))
                assert len((await read_answer(reader))[1][2][1]) == size
            writer.write(request(Call("echo", ()).body.replace(b"</params>", b" " * http.LARGE)))
            assert (await read_answer(reader))[1][0] == -1, "it cannot be read"

    with patch.object(Call, "_read_params", note):
        run(work())
    assert [one is threading.main_thread() for one in threads] == [True, False, False]


def test_a_probe_is_answered_without_a_master():
    """By the program that answers calls; it never gets to roscore."""

    async def none(call: Call, host: str) -> Answer:
        raise AssertionError(call.method)

    async def work() -> None:
        async with door(none) as port, caller(port) as (reader, writer):
            writer.write(b"GET /ready HTTP/1.1\r\nHost: pod\r\n\r\n")
            assert (await reader.readuntil(b"\r\n\r\n")).startswith(b"HTTP/1.1 200 ")
            assert await reader.read() == b""

    run(work())


@pytest.mark.parametrize(
    "document",
    [
        b'<!DOCTYPE x [<!ENTITY a "aaaa">]><methodName>m</methodName>',
        '<!DOCTYPE x [<!ENTITY a "aaaa">]>'.encode("utf-16") + b"<methodName>m</methodName>",
    ],
)
def test_a_document_type_is_refused_unread(document: bytes):
    """Old versions of Expat expand entities without a limit; nothing of it reaches roscore."""

    async def none(call: Call, host: str) -> Answer:
        raise AssertionError(call.method)

    async def work() -> None:
        async with door(none) as port, caller(port) as (reader, writer):
            writer.write(request(document))
            code, message, _ = (await read_answer(reader))[1]
            assert (code, "document type" in message) == (-1, True)

    run(work())
    assert not Answer(body=b"<!DOCTYPE x><methodResponse/>").is_success


CALLED = "<methodCall>{}<methodName>getPid</methodName>{}</methodCall>"


@pytest.mark.parametrize(
    ("text", "method"),
    [
        ("<?xml version='1.0'?>\r\n" + CALLED.format("", ""), "getPid"),
        ("<!-- <methodName>echo</methodName> -->" + CALLED.format("", ""), "getPid"),
        (CALLED.format("<!-- <methodName>echo</methodName>-->", "<params/>"), "getPid"),
        (CALLED.format("", "<!-- a methodName -->"), "getPid"),
        ("<methodCall xmlns:ex='x'>\n<methodName> a.b </methodName></methodCall>", "a.b"),
        ("<!-- " + CALLED.format("", "") + " -->", None),
        (CALLED.format("", "<params/><methodName>echo</methodName>"), None),
        (CALLED.format("", "<x:methodName>echo</x:methodName >"), None),
        (CALLED.format("<params/>", ""), None),
        (50_000 * "<!---->" + 50_000 * "<!-->", None),
    ],
)
def test_a_call_is_the_one_that_roscore_finds_in_it(text: str, method: str | None):
    """A comment hides none, and of two nothing is passed on: roscore takes the last one."""
    if method:
        assert Call.read(text.encode()).method == method
    else:
        with pytest.raises(BadCall):
            Call.read(text.encode())


# -- the master and nodes --


@asynccontextmanager
async def server(*answers: bytes, hangs_up: bool = False) -> AsyncIterator[tuple[int, list[bytes]]]:
    """Serve raw answers, one for each request and then silence; the port, and what was asked."""
    left, asked, writers = list(answers), [], []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        while True:
            try:
                head = await reader.readuntil(b"\r\n\r\n")
            except (EOFError, OSError):
                break
            length = int(head.decode().lower().partition("content-length:")[2].split()[0])
            asked.append(await reader.readexactly(length))
            if not left:
                continue
            writer.write(left.pop(0))
            if hangs_up:
                break
        writer.close()

    listening = await asyncio.start_server(serve, LOCAL, 0)
    yield listening.sockets[0].getsockname()[1], asked
    listening.close()
    for writer in writers:
        writer.close()
    await asyncio.sleep(0.01)


def says(value: Any, *, line: str = "HTTP/1.1 200 OK", head: str = "") -> bytes:
    text = xmlrpc.client.dumps((value,), methodresponse=True).encode()
    return f"{line}\r\n{head}Content-Length: {len(text)}\r\n\r\n".encode() + text


CALL = Call("getPid", ("/me",))


def test_the_masters_connections_are_kept():
    """One after the other by one connection, at once by several."""

    async def work() -> None:
        opened = []

        async def note(call: Call, host: str) -> Answer:
            await asyncio.sleep(0.01)
            return Answer([1, "", 7])

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            opened.append(writer)
            await Door(note, Callers(print, Clock())).serve(reader, writer)

        async with await asyncio.start_server(serve, LOCAL, 0) as listening:
            links = HttpLinks(listening.sockets[0].getsockname()[1])
            for _ in range(3):
                assert (await links.master(CALL)).result == 7
            assert len(opened) == 1
            await asyncio.gather(*(links.master(CALL) for _ in range(3)))
            assert len(opened) == 3
            for connection in links._free:
                connection.close()

    run(work())


@pytest.mark.parametrize(
    "answer",
    [says([1, "", 7], line="HTTP/1.0 200 OK"), says([1, "", 7], head="Connection: close\r\n")],
)
def test_a_connection_that_the_master_ends_is_not_kept(answer: bytes):
    async def work() -> None:
        async with server(answer, answer) as (port, _):
            links = HttpLinks(port)
            for _ in range(2):
                assert (await links.master(CALL)).result == 7
                assert links._free == []

    run(work())


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"HTTP/1.1 200",
        b"HTTP/1.1 200 OK\r\n\r\n",
        b"HTTP/1.1 200 OK\r\nContent-Length: x\r\n\r\n",
        says([1, "", 7])[:-5],
    ],
)
def test_a_master_that_ends_before_its_answer_does_is_gone(answer: bytes):
    async def work() -> None:
        async with server(answer, hangs_up=True) as (port, _):
            with pytest.raises(MasterGone):
                await HttpLinks(port).master(CALL)

    run(work())


def test_no_master_is_gone():
    async def work() -> None:
        async with server() as (port, _):
            pass
        with pytest.raises(MasterGone):
            await HttpLinks(port).master(CALL)
        await HttpLinks(port).until_master_hangs_up()

    run(work())


def test_a_call_that_the_master_refuses_is_not_made_again():
    """An error page is a living master's: the same call again would get it for ever."""

    async def work() -> None:
        async with server(b"HTTP/1.1 500 No\r\nContent-Length: 0\r\n\r\n") as (port, _):
            answer = await HttpLinks(port).master(CALL)
            assert answer.value[0] == -1
            assert "500 No" in answer.value[1]

    run(work())


def test_the_masters_end_is_noticed_at_once():
    """By a connection that says nothing; kept ones are not used any more."""

    async def work() -> None:
        writers = []

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writers.append(writer)
            await Door(echo, Callers(print, Clock())).serve(reader, writer)

        listening = await asyncio.start_server(serve, LOCAL, 0)
        links = HttpLinks(listening.sockets[0].getsockname()[1])
        await links.master(CALL)
        ending = asyncio.ensure_future(links.until_master_hangs_up())
        await asyncio.sleep(0.02)
        assert not ending.done()
        listening.close()
        for one in writers:
            one.transport.abort()
        await asyncio.wait_for(ending, 30)
        assert links._free == []

    run(work())


def test_a_node_is_called_once():
    async def work() -> None:
        async with server(says([1, "", 7])) as (port, asked):
            links = HttpLinks(1)
            answer = await links.node(f"http://{LOCAL}:{port}/", CALL, 1)
            assert answer.result == 7
            assert asked == [CALL.body]

    run(work())


def test_where_no_process_listens_a_node_is_gone():
    """And where another kind of server is, or none that answers in full."""

    async def work() -> None:
        links = HttpLinks(1)
        async with server(b"", b"HTTP/1.1 404 Not Found\r\n\r\n", hangs_up=True) as (port, _):
            api = f"http://{LOCAL}:{port}/"
            await links.connect(api, 1)
            for _ in range(2):
                with pytest.raises(NodeGone):
                    await links.node(api, CALL, 1)
        with pytest.raises(NodeGone):
            await links.connect(api, 1)
        with pytest.raises(NodeGone):
            await links.node(api, CALL, 1)

    run(work())


def test_a_node_that_does_not_answer_is_silent():
    """It is frozen, its machine is away, or its name is unknown here: it may live."""

    async def work() -> None:
        links = HttpLinks(1)
        async with server() as (port, _):
            api = f"http://{LOCAL}:{port}/"
            await links.connect(api, 1)
            with pytest.raises(NodeSilent, match=r"no answer within 0.05 s"):
                await links.node(api, CALL, 0.05)
        with pytest.raises(NodeSilent):
            await links.connect("http://no.such.name.invalid:4711/", 5)

    run(work())


@pytest.mark.parametrize("number", [113, 101, 110])
def test_a_machine_without_a_route_is_silent(number: int, monkeypatch: pytest.MonkeyPatch):
    """No route to host, network unreachable, timed out: only a refusal comes from the machine."""

    async def fail(host: str, port: int) -> http.Connection:
        raise OSError(number, "no")

    monkeypatch.setattr(http.Connection, "open", fail)

    async def work() -> None:
        with pytest.raises(NodeSilent):
            await HttpLinks(1).connect("http://10.9.9.9:1/", 1)

    run(work())


@pytest.mark.parametrize(
    ("api", "place"),
    [
        ("http://10.1.0.3:4711/", ("10.1.0.3", 4711)),
        ("http://robot:4711", ("robot", 4711)),
        ("http://[fd00::1]:4711/", ("fd00::1", 4711)),
    ],
)
def test_the_place_of_a_node(api: str, place: tuple[str, int]):
    assert place_of(api) == place


IMPOSSIBLE = [
    *("", "rosrpc://h:1", "http://h/", "http://:1/", "http://h:x/", "http://[]:1/"),
    *("http://h:0/", "http://h:65536/", "http://h:99999/", "http://h:" + 5000 * "9"),
    *("http://h:\u0661/", "http://h:\u00b2/", "http://h:-1/", "http://h:+1/"),
    *("http://a..b:1/", f"http://{64 * 'a'}:1/", f"http://{64 * 'ä'}:1/", "http://\ud800:1/"),
    *("http://a b:1/", "http://a\r\nX: y:1/", "http://a\0b:1/"),
]


@pytest.mark.parametrize("api", IMPOSSIBLE)
def test_an_address_that_no_socket_can_have_is_no_node(api: str):
    with pytest.raises(NodeGone):
        place_of(api)


@pytest.mark.parametrize("seed", range(20))
def test_any_text_may_be_the_uri_of_a_node(seed: int):
    """A stranger registers what it likes: a look at it ends, with one of three results."""
    chance = random.Random(seed)
    hosts = ["127.0.0.1", "[::1]", "127.1", *" ä\0\r\ud800%;@,.:[]/?#\u0661\u202e\U0001f916"]

    async def work() -> None:
        links = HttpLinks(1)
        nodes = Nodes(Context(State(), links, lambda event: None, lambda line: None))
        for _ in range(20):
            host = "".join(chance.choices(hosts, k=chance.choice([1, 1, 3, 70])))
            port = chance.choice(["1", "0", "65536", "99999", "-1", "", "\u0661", 5000 * "9"])
            api = chance.choice(["http://", "http://", "rosrpc://", ""]) + f"{host}:{port}/"
            assert await nodes.find(api) in (False, None)
            with suppress(NodeGone, NodeSilent):
                await links.node(api, CALL, 0.2)

    run(work())


@pytest.mark.parametrize(
    "answer",
    [
        f"HTTP/1.1 200 OK\r\nContent-Length: {2**20 + 1}\r\n\r\n".encode(),
        b"HTTP/1.1 200 OK\r\nX: " + 2**21 * b"x",
    ],
)
def test_a_node_whose_answer_is_too_large_is_no_node(answer: bytes):
    """4 GB of it would fill the memory of the gate, and of the machine."""

    async def work() -> None:
        async with server(answer) as (port, _):
            with pytest.raises(NodeGone):
                await HttpLinks(1).node(f"http://{LOCAL}:{port}/", CALL, 10)

    run(work())


def test_a_masters_answer_has_a_limit():
    """A larger one than a node's; the caller gets a fault, and the master stays."""

    async def work() -> None:
        large = b"HTTP/1.1 200 OK\r\nContent-Length: %d\r\n\r\n" % (2**26 + 1)
        async with server(large) as (port, _):
            answer = await HttpLinks(port).master(CALL)
            assert answer.value[0] == -1

    run(work())

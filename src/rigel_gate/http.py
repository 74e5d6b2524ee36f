"""XML-RPC over HTTP/1.1 without a thread per connection: the gate's servers and clients."""

from __future__ import annotations

import asyncio
import errno
import re
import time
from typing import Awaitable, Callable, Counter, TypeVar

from rigel_gate.calls import GATE, Answer, BadCall, Call, fault
from rigel_gate.links import MasterGone, NodeGone, NodeSilent

#: Bytes of a head, and of a body, above which a connection is closed.
LARGEST_HEAD, LARGEST_BODY = 65536, 16 * 2**20
#: Bytes of an answer above which a node, and a master, counts as broken.
LARGEST_OF_NODE, LARGEST_OF_MASTER = 2**20, 64 * 2**20
#: Seconds in which the next complete request has to arrive, and the answer to the last one to be
#: read. rosmaster ends idle connections sooner; clients open them again.
IDLE = 60.0
#: How many connections one address may have: all nodes of a machine, with host networking.
MOST_OF_ONE = 512
#: What a probe requests: a worker that answers it serves others, too, with or without a master.
READY = "GET /ready "
#: What `connect` fails with if a machine answers that no process listens.
REFUSED = (errno.ECONNREFUSED, errno.ECONNRESET)

T = TypeVar("T")
#: Answers a call; its second argument is the address that it came from.
Answering = Callable[[Call, str], Awaitable[Answer]]


class Door(asyncio.Protocol):
    """One connection of a caller: requests one after the other.

    It reads no further while a call is answered or answers wait to be read.

    Args:
        callers: how many connections each address has; shared by all doors.
    """

    def __init__(self, answering: Answering, callers: Counter[str]) -> None:
        self._answering = answering
        self._callers = callers
        self._data = bytearray()
        self._busy = False
        self._full = False  # whether the caller does not read its answers
        self._host = ""
        self._task: asyncio.Task[None] | None = None
        self._transport: asyncio.Transport | None = None
        self._ending: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Remember where to send answers."""
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        peer = transport.get_extra_info("peername") or ("",)  # empty if it is closed already
        self._host = peer[0]
        self._callers[self._host] += 1
        if self._callers[self._host] > MOST_OF_ONE:
            transport.abort()
        self._wait()

    def connection_lost(self, error: Exception | None) -> None:
        """Stop answering; a call in progress is still carried out."""
        self._transport = None
        self._callers[self._host] -= 1
        if not self._callers[self._host]:
            del self._callers[self._host]
        if self._ending:
            self._ending.cancel()

    def data_received(self, data: bytes) -> None:
        """Collect the data, and answer when a request is complete."""
        self._data += data
        self._next()

    def pause_writing(self) -> None:
        """Answer nothing more until the caller has read its answers."""
        self._full = True

    def resume_writing(self) -> None:
        """Go on: the caller has read them."""
        self._full = False
        self._next()

    def _wait(self) -> None:
        """Give the caller its time until the next complete request."""
        assert self._transport is not None
        if self._ending:
            self._ending.cancel()
        self._ending = asyncio.get_running_loop().call_later(IDLE, self._transport.abort)

    def _next(self) -> None:
        """Answer the next request if it is complete; read on if it is not."""
        if self._busy or self._full or self._transport is None:
            return
        self._transport.resume_reading()
        end = self._data.find(b"\r\n\r\n")
        if end < 0:
            if len(self._data) > LARGEST_HEAD:
                self._refuse("431 Request Header Fields Too Large")
            return
        head = self._data[:end].decode("latin-1")
        if head.startswith(READY):
            self._refuse("200 OK")
            return
        length = length_of(head)
        if not head.startswith("POST ") or length is None or length > LARGEST_BODY:
            self._refuse("501 Unsupported method" if length is not None else "411 Length Required")
            return
        if len(self._data) < end + 4 + length:
            return
        body = bytes(self._data[end + 4 : end + 4 + length])
        del self._data[: end + 4 + length]
        self._busy = True
        self._transport.pause_reading()
        assert self._ending is not None
        self._ending.cancel()
        self._task = asyncio.ensure_future(self._answer(body, stays=stays_open(head)))

    async def _answer(self, body: bytes, *, stays: bool) -> None:
        try:
            text = (await self._answering(Call.read(body), self._host)).body
        except BadCall as error:
            text = fault(str(error)).body
        except Exception as error:
            text = fault(f"the gate failed: {error!r}").body
        self._busy = False
        if self._transport is not None:
            more = "" if stays else "Connection: close\r\n"
            head = f"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\n{more}"
            self._transport.write(f"{head}Content-Length: {len(text)}\r\n\r\n".encode() + text)
            self._wait()
            if not stays:
                self._transport.close()
                return
        self._next()

    def _refuse(self, status: str) -> None:
        """Answer without a call, and end the connection."""
        assert self._transport is not None
        self._transport.write(
            f"HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".encode()
        )
        self._transport.close()


def length_of(head: str) -> int | None:
    """Return the length of a head's body, 0 if it gives none, None if it is not a number."""
    value = field_of(head, "content-length")
    if value is None:
        return 0
    return int(value) if value.isascii() and value.isdigit() and len(value) < 20 else None


def field_of(head: str, wanted: str) -> str | None:
    """Return a field of a head by its name in lower case, None if it is missing."""
    for line in head.split("\r\n")[1:]:
        name, _, value = line.partition(":")
        if name.strip().lower() == wanted:
            return value.strip()
    return None


def stays_open(head: str) -> bool:
    """Return whether a connection stays open after the answer."""
    first, _, rest = head.lower().partition("\r\n")
    words = [
        line.partition(":")[2] for line in rest.split("\r\n") if line.startswith("connection:")
    ]
    return "close" not in "".join(words) and (
        first.endswith("http/1.1") or "keep-alive" in "".join(words)
    )


class Refused(EOFError):
    """A server has answered with another status than 200, or with too much."""


class Connection:
    """A kept connection to an XML-RPC server.

    Attributes:
        server: the program that answers, as it calls itself; "" before the first answer.
    """

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer
        self.server = ""

    @classmethod
    async def open(cls, host: str, port: int) -> Connection:
        """Connect; raises OSError."""
        return cls(*await asyncio.open_connection(host, port, limit=2**20))

    async def call(self, host: str, body: bytes, largest: int) -> tuple[bytes, bool]:
        """Return (the answer, whether the connection stays open); raises OSError, EOFError.

        Args:
            largest: bytes of an answer that is refused unread if it has more.
        """
        head = f"POST / HTTP/1.1\r\nHost: {host}\r\nContent-Type: text/xml\r\n"
        self._writer.write(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        try:
            raw = await self._reader.readuntil(b"\r\n\r\n")
        except asyncio.LimitOverrunError as error:
            raise Refused("with an endless head") from error
        answer_head = raw[:-4].decode("latin-1")
        if " 200" not in answer_head.partition("\r\n")[0]:
            raise Refused(answer_head.partition("\r\n")[0])
        self.server = field_of(answer_head, "server") or ""
        length = length_of(answer_head)
        if not length:
            raise EOFError("an answer without a length")
        if length > largest:
            raise Refused(f"with {length} bytes")
        first, _, rest = answer_head.partition("\r\n")
        stays = stays_open(f"POST / {first.split()[0]}\r\n{rest}")
        return await self._reader.readexactly(length), stays

    async def until_it_ends(self) -> None:
        """Return when the other side closes; nothing is sent meanwhile."""
        await self._reader.read(1)

    def close(self) -> None:
        """Close it."""
        self._writer.close()


class HttpLinks:
    """The master at a port of this pod, and nodes at their URIs (`Links`)."""

    def __init__(self, port: int, host: str = "127.0.0.1") -> None:
        self._place = (host, port)
        self._free: list[Connection] = []

    async def master(self, call: Call) -> Answer:
        """Call the master over a connection that no one else uses meanwhile; raises MasterGone."""
        connection = self._free.pop() if self._free else None
        stays = False
        try:
            if connection is None:
                connection = await Connection.open(*self._place)
            body, stays = await connection.call("localhost", call.body, LARGEST_OF_MASTER)
        except Refused as error:  # by a running master: the same call would fail again
            return fault(f"the ROS master answered {error}")
        except (OSError, EOFError) as error:
            self._close_free()  # they may be another master's
            raise MasterGone(str(error)) from error
        finally:
            if connection is not None and stays:
                self._free.append(connection)
            elif connection is not None:
                connection.close()
        return Answer(body=body)

    async def until_master_hangs_up(self) -> None:
        """Return when the master has ended an idle connection, or no master is there."""
        try:
            connection = await Connection.open(*self._place)
        except OSError:
            return
        try:
            await connection.until_it_ends()
        except OSError:
            pass
        finally:
            connection.close()
        self._close_free()

    def _close_free(self) -> None:
        for other in self._free:
            other.close()
        self._free.clear()

    async def node(self, api: str, call: Call, seconds: float) -> Answer:
        """Call a node once; raises NodeGone and NodeSilent."""
        return (await self._call_node(api, call, seconds))[0]

    async def server(self, api: str, seconds: float) -> str:
        """Return the program that serves a node's API, as HTTP names it; raises as `node`."""
        return (await self._call_node(api, Call("getPid", (GATE,)), seconds))[1]

    async def _call_node(self, api: str, call: Call, seconds: float) -> tuple[Answer, str]:
        async def ask() -> tuple[Answer, str]:
            host, port = place_of(api)
            connection = await Connection.open(host, port)
            try:
                body, _ = await connection.call(f"{host}:{port}", call.body, LARGEST_OF_NODE)
            finally:
                connection.close()
            return Answer(body=body), connection.server

        return await _in_time(ask(), seconds)

    async def connect(self, api: str, seconds: float) -> None:
        """Return when a node accepts a connection; raises NodeGone and NodeSilent."""

        async def knock() -> None:
            (await Connection.open(*place_of(api))).close()

        await _in_time(knock(), seconds)

    async def sleep(self, seconds: float) -> None:
        """Wait."""
        await asyncio.sleep(seconds)

    def now(self) -> float:
        """Return seconds since the machine started."""
        return time.monotonic()


async def _in_time(work: Awaitable[T], seconds: float) -> T:
    try:
        return await asyncio.wait_for(work, seconds)
    except asyncio.TimeoutError as error:
        raise NodeSilent(f"no answer within {seconds:g} s") from error
    except (EOFError, ValueError, OverflowError) as error:  # no node, or no socket's address
        raise NodeGone(str(error)) from error
    except OSError as error:
        if error.errno in REFUSED:
            raise NodeGone(error.strerror or str(error)) from error
        raise NodeSilent(error.strerror or str(error)) from error


def place_of(api: str) -> tuple[str, int]:
    """Return (host, port) of an http URI; raises NodeGone for what no socket can connect to."""
    host, _, port = api.partition("://")[2].partition("/")[0].rpartition(":")
    host = host.strip("[]")
    try:
        number = int(port) if port.isascii() and port.isdigit() and len(port) < 6 else 0
        sound = not re.search(r"[\s\x00-\x20]", host) and host.encode("idna")
    except UnicodeError:  # a label is empty or too long
        sound = False
    if not api.startswith("http://") or not sound or not 0 < number < 65536:
        raise NodeGone(f"{api!r} is not http://HOST:PORT")
    return host, number

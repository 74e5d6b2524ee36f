"""XML-RPC over HTTP/1.1 without a thread per connection: the gate's servers and clients."""

from __future__ import annotations

import asyncio
import errno
import re
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Awaitable, Callable, Counter, TypeVar

from rigel_gate.calls import LARGE, Answer, BadCall, Call, fault
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
#: How many more may say that they are a probe, and the seconds that they have for it.
MOST_GUESTS, HASTE = 2048, 2.0
#: Seconds between two lines about refused connections, and for how long `describe` has them.
REPORTS, NOTED = 60.0, 600.0
#: What a probe requests: a worker that answers it serves others, too, with or without a master.
READY = "GET /ready "
#: What `connect` fails with if a machine answers that no process listens.
REFUSED = (errno.ECONNREFUSED, errno.ECONNRESET)

#: Where large calls are read, one after the other: each takes several times its size of memory.
THREAD = ThreadPoolExecutor(1)

T = TypeVar("T")
#: Answers a call; its second argument is the address that it came from.
Answering = Callable[[Call, str], Awaitable[Answer]]


class BadRequest(Exception):
    """A request that is answered without a call, and ends its connection; the status."""


class Callers:
    """How many connections each address has, at all doors, and how many were refused.

    Args:
        log: called with a line for people to read.
        clock: the loop, for its time and its timers alone.
    """

    def __init__(self, log: Callable[[str], None], clock: asyncio.AbstractEventLoop) -> None:
        self.clock = clock
        self._log = log
        self._open: Counter[str] = Counter()
        self._refused: dict[str, tuple[int, float]] = {}  # how many, and when the last one
        self._unreported: Counter[str] = Counter()
        self._waits = False  # for the next line

    def enter(self, host: str) -> int:
        """Note a new connection; return how many its address has."""
        self._open[host] += 1
        return self._open[host]

    def leave(self, host: str) -> None:
        """Note that a connection has ended."""
        self._open[host] -= 1
        if not self._open[host]:
            del self._open[host]

    def refuse(self, host: str) -> None:
        """Note a refused connection; log it now, or with others a minute after the last line."""
        self._refused[host] = (self._refused.get(host, (0, 0.0))[0] + 1, self.clock.time())
        self._unreported[host] += 1
        if not self._waits:
            self._report()

    def _report(self) -> None:
        self._waits = bool(self._unreported)
        if self._waits:
            found = ", ".join(f"{n} of {host}" for host, n in self._unreported.most_common(5))
            self._log(f"refused connections: {found}; an address has at most {MOST_OF_ONE}")
            self._unreported.clear()
            self.clock.call_later(REPORTS, self._report)

    def list_notes(self) -> list[str]:
        """Return which addresses were refused connections lately."""
        late = self.clock.time() - NOTED
        self._refused = {host: one for host, one in self._refused.items() if one[1] >= late}
        return [
            f"the gate has refused {count} connections of {host}, which has {MOST_OF_ONE} already"
            for host, (count, _) in self._refused.items()
        ]


class Door:
    """Answers the calls of callers: of each connection one after the other.

    It reads no further while a call is answered or answers wait to be read.

    Args:
        callers: shared by all doors.
    """

    def __init__(self, answering: Answering, callers: Callers) -> None:
        self._answering = answering
        self._callers = callers

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Answer until either side ends the connection; a call in progress is carried out."""
        host = (writer.get_extra_info("peername") or ("",))[0]  # None if it is closed already
        count = self._callers.enter(host)
        try:
            if count <= MOST_OF_ONE:
                await self._answer_calls(host, reader, writer)
            elif count > MOST_OF_ONE + MOST_GUESTS or not await self._is_probe(reader, writer):
                self._callers.refuse(host)
                say(writer, "503 Service Unavailable")
            else:
                say(writer, "200 OK")
        except (EOFError, OSError):
            pass  # the caller has ended it
        finally:
            self._callers.leave(host)
            writer.close()
            if writer.transport.get_write_buffer_size():
                self._limit(writer)

    async def _is_probe(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        """Return whether a connection is a probe's: the kubelet has the address of a machine."""
        ending = self._callers.clock.call_later(HASTE, reader.feed_eof)
        try:
            return (await _read_head(reader))[0].startswith(READY)
        except (EOFError, asyncio.LimitOverrunError):
            return False
        finally:
            ending.cancel()

    async def _answer_calls(
        self, host: str, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        stays = True
        while stays:
            ending = self._limit(writer)
            try:
                await writer.drain()
                stays, body = await _read_request(reader)
            except BadRequest as refusal:
                say(writer, str(refusal))
                return
            finally:
                ending.cancel()
            text = await self._answer(body, host)
            more = "" if stays else "Connection: close\r\n"
            head = f"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\n{more}"
            ending = self._limit(writer)
            try:
                await send(writer, f"{head}Content-Length: {len(text)}\r\n\r\n", text)
            finally:
                ending.cancel()

    async def _answer(self, body: bytes, host: str) -> bytes:
        try:
            read = partial(Call.read, body)
            call = read() if len(body) <= LARGE else await compute(read)
            return (await self._answering(call, host)).body
        except BadCall as error:
            return fault(str(error)).body
        except Exception as error:
            return fault(f"the gate failed: {error!r}").body

    def _limit(self, writer: asyncio.StreamWriter) -> asyncio.TimerHandle:
        """End a connection after IDLE."""
        return self._callers.clock.call_later(IDLE, writer.transport.abort)


async def send(writer: asyncio.StreamWriter, head: str, body: bytes) -> None:
    """Send a request or an answer in pieces; the last piece may still be on its way."""
    writer.write(head.encode() + body[:LARGE])
    for start in range(LARGE, len(body), LARGE):
        await writer.drain()
        writer.write(body[start : start + LARGE])


def say(writer: asyncio.StreamWriter, status: str) -> None:
    """Answer with a status alone; the connection ends."""
    writer.write(f"HTTP/1.1 {status}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n".encode())


async def compute(work: Callable[[], T]) -> T:
    """Return what a function returns that takes long, in one thread; others are answered."""
    return await asyncio.get_running_loop().run_in_executor(THREAD, work)


async def _read_request(reader: asyncio.StreamReader) -> tuple[bool, bytes]:
    """Return (whether the connection stays open, the body); raises BadRequest, EOFError."""
    try:
        first, fields = await _read_head(reader)
    except asyncio.LimitOverrunError as error:
        raise BadRequest("431 Request Header Fields Too Large") from error
    if first.startswith(READY):
        raise BadRequest("200 OK")
    length = _length_of(fields)
    if length is None:
        raise BadRequest("411 Length Required")
    if not first.startswith("POST ") or length > LARGEST_BODY:
        raise BadRequest("501 Unsupported method")
    return _stays_open(first, fields), await reader.readexactly(length)


async def _read_head(reader: asyncio.StreamReader) -> tuple[str, dict[str, str]]:
    """Return (the first line, fields by their names in lower case) of a request or an answer."""
    raw = await reader.readuntil(b"\r\n\r\n")
    first, *lines = raw[:-4].decode("latin-1").split("\r\n")
    pairs = (line.partition(":") for line in lines)
    return first, {name.strip().lower(): value.strip() for name, _, value in pairs}


def _length_of(fields: dict[str, str]) -> int | None:
    """Return the length of a body, 0 if its head gives none, None if it is not a number."""
    value = fields.get("content-length", "0")
    return int(value) if value.isascii() and value.isdigit() and len(value) < 20 else None


def _stays_open(first: str, fields: dict[str, str]) -> bool:
    """Return whether a connection stays open after the answer."""
    wish = fields.get("connection", "").lower()
    return "close" not in wish and ("HTTP/1.1" in first or "keep-alive" in wish)


class Refused(EOFError):
    """A server has answered with another status than 200, or with too much."""


class Connection:
    """A kept connection to an XML-RPC server."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader = reader
        self._writer = writer

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
        await send(self._writer, f"{head}Content-Length: {len(body)}\r\n\r\n", body)
        try:
            first, fields = await _read_head(self._reader)
        except asyncio.LimitOverrunError as error:
            raise Refused("with an endless head") from error
        if " 200" not in first:
            raise Refused(first)
        length = _length_of(fields)
        if not length:
            raise EOFError("an answer without a length")
        if length > largest:
            raise Refused(f"with {length} bytes")
        return await self._reader.readexactly(length), _stays_open(first, fields)

    async def until_it_ends(self) -> None:
        """Return when the other side closes; nothing is sent meanwhile."""
        await self._reader.read(1)

    def close(self) -> None:
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

        async def ask() -> Answer:
            host, port = place_of(api)
            connection = await Connection.open(host, port)
            try:
                body, _ = await connection.call(f"{host}:{port}", call.body, LARGEST_OF_NODE)
            finally:
                connection.close()
            return Answer(body=body)

        return await _in_time(ask(), seconds)

    async def connect(self, api: str, seconds: float) -> None:
        """Return when a node accepts a connection; raises NodeGone and NodeSilent."""

        async def knock() -> None:
            (await Connection.open(*place_of(api))).close()

        await _in_time(knock(), seconds)

    async def compute(self, work: Callable[[], T]) -> T:
        """Return what a function returns; others are answered meanwhile."""
        return await compute(work)

    async def sleep(self, seconds: float) -> None:
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

"""Calls to ROS masters and nodes, many at once: one conversation is one connection.

A stopped node uses only its own deadline. The module is independent of what is called.
"""

from __future__ import annotations

import asyncio
import xmlrpc.client
from typing import Any

from rigel_inpod import rosrpc
from rigel_inpod.rosrpc import CallFailed

_BROKEN = (
    OSError,
    EOFError,
    asyncio.TimeoutError,
    asyncio.LimitOverrunError,
    ValueError,
    OverflowError,  # a port that no socket has
    KeyError,
)
_HEAD = "POST /RPC2 HTTP/1.1\r\nHost: {}:{}\r\nContent-Type: text/xml\r\nContent-Length: {}\r\n\r\n"


#: Bytes of a node's answer above which it counts as none; rosrpc.LARGEST is a master's.
LARGEST_OF_NODE = 1 << 20


class Refused(CallFailed):
    """The server answered with an error: its code is not 1."""


class Conversation:
    """Calls to one ROS XML-RPC server, one after the other."""

    def __init__(
        self, uri: str, caller: str, seconds: float, largest: int = LARGEST_OF_NODE
    ) -> None:
        """Start the deadline.

        Args:
            uri: of the server, http://HOST:PORT/.
            caller: the caller's ROS name.
            seconds: how long all calls together may take.
            largest: bytes that an answer may have.
        """
        self._address: tuple[str, int] = rosrpc.split(uri)
        self._caller, self._largest = caller, largest
        self._loop = asyncio.get_running_loop()
        self._end = self._loop.time() + seconds
        self._streams: tuple[asyncio.StreamReader, asyncio.StreamWriter] | None = None

    async def call(self, method: str, *arguments: Any) -> Any:
        """Return a method's value: nested lists of text.

        Raises:
            Refused: the server answers with an error.
            CallFailed: it does not answer in time, or its answer is not ROS'.
        """
        body = xmlrpc.client.dumps((self._caller, *arguments), method).encode()
        left = self._end - self._loop.time()
        if left <= 0:
            raise CallFailed("timed out")
        try:
            answer = await asyncio.wait_for(self._post(body), left)
        except _BROKEN as error:
            self.close()
            raise CallFailed(str(error) or type(error).__name__) from error
        if isinstance(answer, list) and answer and isinstance(answer[0], list):
            return answer  # roscpp answers getBusStats without a code
        if not isinstance(answer, list) or len(answer) != 3:
            raise CallFailed("it does not speak ROS")
        if answer[0] != "1":
            raise Refused(str(answer[1]))
        return answer[2]

    @property
    def local_address(self) -> str | None:
        """The address of this side of the connection; None without a connection."""
        found = self._streams and self._streams[1].get_extra_info("sockname")
        return str(found[0]) if found else None

    def close(self) -> None:
        """End the connection."""
        if self._streams:
            self._streams[1].close()
            self._streams = None

    async def _post(self, body: bytes) -> Any:
        if self._streams is None:
            self._streams = await asyncio.open_connection(*self._address)
        reader, writer = self._streams
        writer.write(_HEAD.format(*self._address, len(body)).encode() + body)
        head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1")
        status, _, rest = head.partition("\r\n")
        fields = dict(line.lower().split(":", 1) for line in rest.split("\r\n") if ":" in line)
        length = int(fields["content-length"])
        if length > self._largest:
            raise ValueError("its answer is too large")
        text = await reader.readexactly(length)
        if status.startswith("HTTP/1.0") or "close" in fields.get("connection", ""):
            self.close()
        if " 200" not in status:
            raise ValueError(f"it answered {status}")
        return rosrpc.parse(text.decode("utf-8", "replace"))

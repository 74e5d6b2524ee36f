"""One named topic of ROS 1: received from all its publishers, through their restarts.

Its caller passes the publishers. For each a thread blocks on a socket and counts, by TCPROS, as a
subscriber of any type; it keeps only the first bytes of each message, unless whole messages are
requested.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress

from rigel_exporter import messages
from rigel_exporter.ros1_view import connect_node
from rigel_exporter.samples import Subscription
from rigel_inpod.rosrpc import CallFailed

#: Seconds between two tries to connect to a publisher, the first and the longest.
_RETRY, _RETRY_LONGEST = 0.5, 10.0
_ANSWER = 5.0
#: Larger messages are counted but not kept, in bytes.
LARGEST_KEPT = 1 << 20
#: The bytes of a Header up to the end of its stamp.
STAMP = 12
_CHUNK = 1 << 16
_LARGEST_HEADER = 1 << 20
_CONNECT = 5.0


class TopicSubscription(Subscription):
    """A topic's subscriber."""

    def __init__(
        self, topic: str, keep: int, leave: Callable[[Subscription], None], caller: str
    ) -> None:
        """Connect to no publisher yet; `caller` is the ROS name that subscribes."""
        super().__init__(topic, keep, leave)
        self.caller = caller
        self._links: dict[str, _Link] = {}
        self._links_lock = threading.Lock()
        self._closed = False

    def follow(self, uris: Iterable[str]) -> None:
        """Receive from these publishers only."""
        wanted = set(uris)
        with self._links_lock:
            if self._closed:
                return
            gone = [self._links.pop(uri) for uri in set(self._links) - wanted]
            new = [_Link(uri, self) for uri in wanted - set(self._links)]
            self._links.update((link.uri, link) for link in new)
        for link in gone:
            link.close()
        for link in new:
            link.start()

    def close(self) -> None:
        """Stop receiving, and unregister at the master."""
        self.follow(())
        with self._links_lock:
            self._closed = True
        super().close()


class _Link:
    """The thread that receives from one publisher, and connects again until it is closed."""

    def __init__(self, uri: str, subscription: TopicSubscription) -> None:
        self.uri, self._subscription = uri, subscription
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._stream: Stream | None = None

    def start(self) -> None:
        """Start to receive."""
        name = f"{self._subscription.topic} {self.uri}"
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def close(self) -> None:
        """Stop; the thread ends soon."""
        with self._lock:
            self._closed.set()
            if self._stream:
                self._stream.close()

    def _run(self) -> None:
        pause = _RETRY
        while not self._closed.is_set():
            began = time.monotonic()
            self._follow_once()
            lasted = time.monotonic() - began > _RETRY_LONGEST
            pause = _RETRY if lasted else min(2 * pause, _RETRY_LONGEST)
            self._closed.wait(pause)

    def _follow_once(self) -> None:
        topic, caller = self._subscription.topic, self._subscription.caller
        try:
            stream = Stream(*_find_address(self.uri, topic, caller), topic, caller)
        except (StreamFailed, CallFailed):
            return
        with self._lock:
            self._stream = stream
            if self._closed.is_set():
                stream.close()
        stream.listen(self._take, keep=self._subscription.keeps)
        stream.close()

    def _take(self, size: int, stamp: float | None, payload: bytes | None) -> None:
        self._subscription.count(size, stamp, time.time())
        if payload is not None:
            self._subscription.keep(payload)


def _find_address(uri: str, topic: str, caller: str) -> tuple[str, int]:
    """Return the address at which a publisher sends a topic by TCP.

    Raises:
        CallFailed: it does not return one.
    """
    with connect_node(uri, caller, _ANSWER) as publisher:
        try:
            _, host, port = publisher.ask("requestTopic", topic, [["TCPROS"]])
            return str(host), int(port)
        except (ValueError, TypeError) as error:
            raise CallFailed(str(error)) from error


class StreamFailed(Exception):
    """The topic cannot be received from the publisher; the message has the cause."""


class Stream:
    """A connection to a publisher; `heard` gets (size, stamp, payload or None) of each message."""

    def __init__(self, host: str, port: int, topic: str, caller: str) -> None:
        """Connect, and exchange headers.

        Raises:
            StreamFailed: no connection is possible, or the publisher refuses.
        """
        try:
            self._socket = socket.create_connection((host, port), _CONNECT)
            _watch(self._socket)
            wishes = {"callerid": caller, "topic": topic, "md5sum": "*", "type": "*"}
            self._socket.sendall(encode_header({**wishes, "tcp_nodelay": "0"}))
            fields = decode_header(self._read_exactly(min(self._length(), _LARGEST_HEADER)))
        except (OSError, ValueError) as error:
            raise StreamFailed(str(error)) from error
        if "error" in fields:
            raise StreamFailed(fields["error"])
        self._stamped = messages.has_header(fields.get("message_definition", ""))
        self._socket.settimeout(None)

    def listen(
        self, heard: Callable[[int, float | None, bytes | None], None], *, keep: bool
    ) -> None:
        """Receive until the connection ends or is closed.

        Args:
            heard: is called with each message's size in bytes, its stamp, and itself if it is kept.
            keep: pass whole messages, if they are not larger than LARGEST_KEPT.
        """
        scratch = bytearray(_CHUNK)
        with suppress(OSError, ValueError):
            while True:
                size = self._length()
                whole = keep and size <= LARGEST_KEPT
                first = self._read_exactly(size if whole else min(size, STAMP))
                stamp = self._read_stamp(first)
                self._skip(size - len(first), scratch)
                heard(size, stamp, first if whole else None)

    def close(self) -> None:
        """End the connection, so `listen` returns."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()

    def _read_stamp(self, first: bytes) -> float | None:
        if not self._stamped or len(first) < STAMP:
            return None
        return messages.ros1(first).stamp() or None

    def _length(self) -> int:
        found: int = struct.unpack("<I", self._read_exactly(4))[0]
        return found

    def _read_exactly(self, size: int) -> bytes:
        data = bytearray()
        while len(data) < size:
            data += self._read_some(size - len(data))
        return bytes(data)

    def _read_some(self, size: int) -> bytes:
        data = self._socket.recv(min(size, _CHUNK))
        if not data:
            raise ValueError("the publisher has ended the connection")
        return data

    def _skip(self, size: int, scratch: bytearray) -> None:
        view = memoryview(scratch)
        while size > 0:
            got = self._socket.recv_into(view[: min(size, len(scratch))])
            if not got:
                raise ValueError("the publisher has ended the connection")
            size -= got


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Return a TCPROS connection header with its length in front."""
    lines = [f"{key}={value}".encode() for key, value in fields.items()]
    body = b"".join(struct.pack("<I", len(line)) + line for line in lines)
    return struct.pack("<I", len(body)) + body


def decode_header(data: bytes) -> dict[str, str]:
    """Return the fields of a connection header.

    Raises:
        ValueError: it is not one.
    """
    return dict(_fields(data))


def _fields(data: bytes) -> Iterator[tuple[str, str]]:
    at = 0
    while at < len(data):
        if at + 4 > len(data):
            raise ValueError("it does not speak TCPROS")
        size = struct.unpack_from("<I", data, at)[0]
        key, sign, value = data[at + 4 : at + 4 + size].decode("utf-8", "replace").partition("=")
        if not sign:
            raise ValueError("it does not speak TCPROS")
        yield key, value
        at += 4 + size


def _watch(connection: socket.socket) -> None:
    """Detect within half a minute that the publisher's machine is unreachable."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 10)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 5)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, 3)

"""One named topic of ROS 1: received from all its publishers, through their restarts.

It counts what arrives; its caller passes the publishers.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

from rigel_exporter.graph import Samples
from rigel_exporter.ros1_calls import Conversation
from rigel_exporter.ros1_stream import Stream, StreamFailed
from rigel_inpod.rosrpc import CallFailed

#: Seconds between two tries to connect to a publisher, the first and the longest.
_RETRY, _RETRY_LONGEST = 0.5, 10.0
_ANSWER = 5.0


class Hearing:
    """A topic's subscriber; `left` is called when it is closed."""

    def __init__(self, topic: str, caller: str, keep: int, left: Callable[[Hearing], None]) -> None:
        """Connect to no publisher yet; keep so many of the latest messages."""
        self.topic = topic
        self._caller, self._left = caller, left
        self._lock = threading.Lock()
        self._messages = self._size = 0
        self._last: float | None = None
        self._stamp: float | None = None
        self._kept: deque[bytes] = deque(maxlen=keep)
        self._links: dict[str, _Link] = {}
        self._closed = False

    def publishers(self, uris: Iterable[str]) -> None:
        """Receive from these publishers only."""
        wanted = set(uris)
        with self._lock:
            if self._closed:
                return
            gone = [self._links.pop(uri) for uri in set(self._links) - wanted]
            new = [_Link(uri, self) for uri in wanted - set(self._links)]
            self._links.update((link.uri, link) for link in new)
        for link in gone:
            link.close()
        for link in new:
            link.start()

    def samples(self) -> Samples:
        """Return the counts up to now; kept payloads are handed out once."""
        with self._lock:
            payloads = tuple(self._kept)
            self._kept.clear()
            return Samples(self._messages, self._size, self._last, self._stamp, payloads)

    def close(self) -> None:
        """Stop receiving, and unregister at the master."""
        self.publishers(())
        with self._lock:
            self._closed = True
        self._left(self)

    # -- for the links --

    @property
    def caller(self) -> str:
        """The ROS name that subscribes."""
        return self._caller

    @property
    def keeps(self) -> bool:
        """Whether whole messages are kept."""
        return self._kept.maxlen != 0

    def count_message(self, size: int, stamp: float | None, payload: bytes | None) -> None:
        """Count a message."""
        with self._lock:
            self._messages += 1
            self._size += size
            self._last = time.time()
            self._stamp = stamp
            if payload is not None:
                self._kept.append(payload)


class _Link:
    """The thread that receives from one publisher, and connects again until it is closed."""

    def __init__(self, uri: str, hearing: Hearing) -> None:
        self.uri, self._hearing = uri, hearing
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._stream: Stream | None = None

    def start(self) -> None:
        """Start to receive."""
        threading.Thread(
            target=self._run, name=f"{self._hearing.topic} {self.uri}", daemon=True
        ).start()

    def close(self) -> None:
        """Stop; the thread ends soon."""
        with self._lock:
            self._closed.set()
            if self._stream:
                self._stream.close()

    def _run(self) -> None:
        pause = _RETRY
        while not self._closed.wait(0):
            began = time.monotonic()
            self._follow_once()
            pause = (
                _RETRY
                if time.monotonic() - began > _RETRY_LONGEST
                else min(2 * pause, _RETRY_LONGEST)
            )
            self._closed.wait(pause)

    def _follow_once(self) -> None:
        hearing = self._hearing
        try:
            host, port = _address(self.uri, hearing.topic, hearing.caller)
            stream = Stream(host, port, hearing.topic, hearing.caller)
        except StreamFailed:
            return
        with self._lock:
            self._stream = stream
            if self._closed.is_set():
                stream.close()
        stream.listen(hearing.count_message, keep=hearing.keeps)
        stream.close()


def _address(uri: str, topic: str, caller: str) -> tuple[str, int]:
    """Return the address at which a publisher sends a topic by TCP.

    Raises:
        StreamFailed: it does not return one.
    """
    try:
        _, host, port = asyncio.run(_ask_publisher(uri, topic, caller))
        return str(host), int(port)
    except (CallFailed, ValueError, TypeError) as error:
        raise StreamFailed(str(error)) from error


async def _ask_publisher(uri: str, topic: str, caller: str) -> Any:
    """Return a publisher's answer: the protocol and the address."""
    talk = Conversation(uri, caller, _ANSWER)
    try:
        return await talk.call("requestTopic", topic, [["TCPROS"]])
    finally:
        talk.close()

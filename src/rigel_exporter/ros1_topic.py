"""One named topic of ROS 1: received from all its publishers, through their restarts.

Its caller passes the publishers; each has a thread that receives from it.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable

from rigel_exporter.ros1_stream import Stream, StreamFailed
from rigel_exporter.ros1_view import connect_node
from rigel_exporter.samples import Subscription
from rigel_inpod.rosrpc import CallFailed

#: Seconds between two tries to connect to a publisher, the first and the longest.
_RETRY, _RETRY_LONGEST = 0.5, 10.0
_ANSWER = 5.0


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

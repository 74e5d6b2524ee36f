"""Whether a container still runs: its log ends with it."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress

from urllib3.connection import HTTPConnection

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.connections import Stream
from rigel_k8s.objects.refs import ObjectRef

ANSWERS = 8  # durations of an answer: how long the end of a log may take


class LogEnd:
    """Follows a container's log in a thread of its own, until the log ends or `abort`.

    A pod's status still reports for a second or more that a container runs which has crashed; the
    log has the present answer of the container runtime. A quiet container's log and a slow machine
    both send nothing for a while: so the time of an answer that certainly comes is measured first.

    Args:
        pod: its reference.
        seconds: for how long the log must go on, at least, before the container counts as running.

    Attributes:
        ended: the log has ended, and the container with it.
        over: nothing more will be known; without `ended` it is unknown whether the container runs.
    """

    def __init__(self, client: Client, pod: ObjectRef, container: str, seconds: float):
        self.client, self.pod, self.container, self.seconds = client, pod, container, seconds
        self.ended = self.over = self.aborted = False
        self.begun: float | None = None
        self.connection: HTTPConnection | None = None
        threading.Thread(target=self.follow, daemon=True).start()

    @property
    def settled(self) -> bool:
        """Whether the log has ended or has gone on long enough, or that cannot be known."""
        begun = self.begun
        return self.over or (begun is not None and time.monotonic() - begun >= self.seconds)

    def follow(self) -> None:
        with suppress(RigelK8sError, OSError, ValueError, AttributeError):  # refused, or aborted
            self.ended = self.read()
        self.over = True

    def read(self) -> bool:
        """Return whether the log has ended, when nothing more comes."""
        what = f"follow the log of {self.pod}"
        query = {"container": self.container, "tailLines": "0"}
        url = self.client.path_of(self.pod, what, subresource="log", query=query)
        transport, asked = self.client.transport, time.monotonic()
        self.client.raise_for(transport.request("GET", url, what), what)
        self.seconds = max(self.seconds, ANSWERS * (time.monotonic() - asked))
        self.connection = transport.connect(what)
        if self.aborted:  # before there was a connection to shut down
            self.connection.close()
            return False
        self.begun = time.monotonic()
        url = f"{url}&follow=true"
        stream = transport.stream_on(self.connection, url, what, timeout=None, patience=None)
        if not isinstance(stream, Stream):
            return False
        for _ in stream.lines():
            pass
        return stream.ended and not self.aborted

    def abort(self) -> None:
        """Stop following; the API server's answer may not have begun yet."""
        self.aborted = True
        sock = self.connection.sock if self.connection is not None else None
        if sock is not None:
            with suppress(OSError, ValueError, AttributeError):
                sock.shutdown(socket.SHUT_RDWR)

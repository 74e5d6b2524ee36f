"""Requests to one API server by HTTP: sent, sent again if that is right, answered as bytes.

It handles bytes and headers, not what Kubernetes means by them.
"""

from __future__ import annotations

import re
import socket
import threading
import time
from collections.abc import Callable, Mapping

import attrs
import urllib3
from urllib3.connection import HTTPConnection

from rigel_k8s.kube.connections import (
    BLOCK,
    BROKEN,
    READ_TIMEOUT,
    Connections,
    Stream,
    is_sent,
    is_untrusted,
    reason_of,
)
from rigel_k8s.kube.failures import Cancelled, unreachable_error
from rigel_k8s.kube.target import Target

WHOLE_TIMEOUT = 300.0  # seconds until an answer is complete, even a slow one


@attrs.frozen
class Answer:
    """A complete answer.

    Attributes:
        doubtful: the request was sent more than once, and an earlier one may have been carried out.
    """

    status: int
    headers: Mapping[str, str]
    body: bytes
    doubtful: bool = False


class Transport:
    """Requests to one API server."""

    def __init__(self, target: Target):
        self.target = target
        self.connections = Connections(target)
        self.endurance: Endurance | None = None
        self.guard: Callable[[], None] | None = None  # called before a write is sent again
        self.answered = False

    def request(
        self,
        method: str,
        path: str,
        what: str,
        *,
        body: bytes | None = None,
        media: str = "",
        accept: str = "application/json",
        safe: bool | None = None,
        endures: bool = True,
        doubtful: bool = False,
    ) -> Answer:
        """Send a request and return the complete answer, with any status.

        With an `endurance`, it waits for a server that has answered before and is unreachable.

        Args:
            what: the action, as a phrase.
            safe: whether sending it twice is harmless; None: if the method only reads.
            endures: whether an answer such as 503 means that the server is unreachable.
            doubtful: it was sent before, and may have been carried out.

        Raises:
            ClusterError: there is no answer.
        """
        own = {"Accept": accept, **({"Content-Type": media} if media else {})}
        safe = method == "GET" if safe is None else safe
        again, fresh = Resending(safe, self.is_enduring(), doubtful=doubtful), False
        while True:
            if again.is_resent and method != "GET" and self.guard:
                self.guard()
            try:
                answer = self.exchange(method, path, self.headers(own, fresh=fresh), body)
            except BROKEN as error:
                failure = self.unreachable_error(what, error)
                pause = again.after_loss(sent=is_sent(error))
                if pause is None or is_untrusted(error):
                    raise failure from error
                self.pause(pause, again, what, f"does not answer ({reason_of(error)})")
                continue
            if answer.status == 401 and not fresh:
                fresh = True
                continue
            again.endures = again.endures and endures
            pause = again.after_answer(answer.status, answer.headers)
            if pause is None:
                if answer.status < 500 and self.endurance:
                    self.endurance.end()
                return attrs.evolve(answer, doubtful=again.doubtful)
            self.pause(pause, again, what, f"is not available (HTTP status {answer.status})")

    def exchange(
        self, method: str, path: str, headers: urllib3.HTTPHeaderDict, body: bytes | None
    ) -> Answer:
        """Send a request once and return the answer; raises one of BROKEN."""
        end = time.monotonic() + WHOLE_TIMEOUT
        response = self.connections.pool().urlopen(
            method,
            self.target.server + path,
            body=body,
            headers=headers,
            retries=False,
            redirect=False,
            preload_content=False,
        )
        blocks = []
        try:
            while block := response.read1(BLOCK):
                blocks.append(block)
                if time.monotonic() > end:
                    raise TimeoutError(f"the answer was not complete after {WHOLE_TIMEOUT:g} s")
        except BaseException:
            response.close()
            raise
        response.release_conn()
        self.answered = True
        return Answer(response.status, response.headers, b"".join(blocks))

    def is_enduring(self) -> bool:
        """Whether to wait for an unreachable server: not at first, and not when interrupted."""
        return self.answered and self.endurance is not None and not self.endurance.cancel.is_set()

    def pause(self, seconds: float, again: Resending, what: str, reason: str) -> None:
        """Wait before a request is sent again.

        Raises:
            Cancelled: the user asked to stop meanwhile.
        """
        if self.endurance is None or not again.endures:
            time.sleep(seconds)
            return
        if again.is_noticeable(seconds):
            self.endurance.begin(self.target.server, reason)
        if self.endurance.cancel.wait(seconds):
            raise Cancelled(
                f"interrupted: cannot {what}: the cluster at {self.target.server} {reason}",
                hint="run it again when the cluster answers",
            )

    def headers(self, own: Mapping[str, str], *, fresh: bool = False) -> urllib3.HTTPHeaderDict:
        """Return a request's headers; those with our credentials may repeat a name."""
        whole = urllib3.HTTPHeaderDict({**own, "User-Agent": "rigel"})
        for name, value in self.connections.authorization(fresh=fresh):
            whole.add(name, value)
        return whole

    def stream(
        self, path: str, what: str, *, timeout: float | None, patience: float = READ_TIMEOUT
    ) -> Stream | Answer:
        """Send a GET with an endless answer; an answer that is an error is complete.

        Args:
            timeout: seconds without a byte after which the stream counts as broken; None: never.
            patience: seconds until the answer begins.
        """
        connection = self.connect(what)
        return self.stream_on(connection, path, what, timeout=timeout, patience=patience)

    def stream_on(
        self,
        connection: HTTPConnection,
        path: str,
        what: str,
        *,
        timeout: float | None,
        patience: float | None,
    ) -> Stream | Answer:
        """Do so on a connection that the caller may shut down; no patience is endless."""
        headers = self.headers({"Accept": "application/json"})
        sock = connection.sock
        try:
            sock.settimeout(patience)
            connection.timeout = patience  # otherwise it would apply to the answer's beginning
            connection.request(
                "GET", self.connections.url.path + path, headers=headers, preload_content=False
            )
            response = connection.getresponse()
            if response.status >= 400:
                answer = Answer(response.status, response.headers, response.data)
                connection.close()
                return answer
        except BROKEN as error:
            connection.close()
            raise self.unreachable_error(what, error) from error
        sock.settimeout(timeout)
        return Stream(connection, response, sock)

    def open_socket(self, what: str) -> socket.socket:
        """Return a connected socket (with TLS) for a protocol of its own."""
        sock = self.connect(what).sock
        sock.settimeout(READ_TIMEOUT)
        return sock

    def conceal(self, body: bytes) -> bytes:
        """Return an answer to be shown, without our credentials: a proxy's page may repeat them."""
        for name, value in self.connections.authorization():
            if name.lower() == "authorization":
                secret = value.rpartition(" ")[2].encode()
                body = body.replace(secret, b"***") if secret else body
        return body

    def connect(self, what: str) -> HTTPConnection:
        """Return a connection of the caller's own."""
        try:
            return self.connections.connect()
        except BROKEN as error:
            raise self.unreachable_error(what, error) from error

    def unreachable_error(self, what: str, error: BaseException) -> Exception:
        """Return the error for a server that gave no answer."""
        reason = reason_of(error)
        target = self.target
        return unreachable_error(what, reason, context=target.context, server=target.server)


RETRIES = 5  # of requests that the server asks us to send again
RETRY_BUDGET = 30.0  # seconds that one request may spend waiting to be sent again
AWAY = 120.0  # seconds that long work waits for an unreachable server
FIRST_PAUSE, LONGEST_PAUSE = 0.25, 5.0
SILENT = 1.0  # seconds of waiting that are not reported
BUSY = frozenset({429, 500, 502, 503, 504})


@attrs.define
class Endurance:
    """How long work waits for an unreachable API server.

    Attributes:
        log: called with a line when the wait begins, and when it is over.
        cancel: ends the wait soon after it is set.
        since: when the server became unreachable, None while it answers.
        total: the seconds of all outages that are over.
    """

    log: Callable[[str], None]
    cancel: threading.Event
    since: float | None = None
    total: float = 0.0
    lock: threading.Lock = attrs.field(factory=threading.Lock)

    def begin(self, server: str, reason: str) -> None:
        """Note that the server is unreachable; the first thread reports it."""
        with self.lock:
            first, self.since = self.since is None, self.since or time.monotonic()
        if first:
            self.log(f"the cluster at {server} {reason}: waiting up to {AWAY:g} s for it")

    def end(self) -> None:
        """Note that the server answers."""
        with self.lock:
            if self.since is None:
                return
            lasted = time.monotonic() - self.since
            self.since, self.total = None, self.total + lasted
        self.log(f"the cluster answers again, after {lasted:.0f} s")

    def sum_outages(self) -> float:
        """Return for how many seconds the server was unreachable in total."""
        with self.lock:
            return self.total + (time.monotonic() - self.since if self.since else 0.0)


@attrs.define
class Resending:
    """One request: what has happened to it so far, and whether it is sent again.

    Attributes:
        safe: sending it twice is harmless.
        endures: it belongs to work that waits for an unreachable server.
        doubtful: it was sent, and it is unknown whether it was carried out.
    """

    safe: bool
    endures: bool
    started: float = attrs.field(factory=time.monotonic)
    losses: int = 0
    refusals: int = 0
    doubtful: bool = False

    @property
    def is_resent(self) -> bool:
        """Whether it has been sent before."""
        return bool(self.losses or self.refusals or self.doubtful)

    def after_loss(self, *, sent: bool) -> float | None:
        """Return the seconds to wait after a lost answer, None to give up.

        Args:
            sent: the server may have received the request.
        """
        self.losses += 1
        self.doubtful = self.doubtful or sent
        if sent and not self.safe:
            return None
        if self.losses == 1:
            return 0.0
        return self.within(backoff(self.losses), AWAY) if self.endures else None

    def after_answer(self, status: int, headers: Mapping[str, str]) -> float | None:
        """Return the seconds to wait after a busy server's answer, None if the answer is final."""
        if status not in BUSY:
            return None
        self.refusals += 1
        asked = retry_after(headers)
        if not self.endures:
            short = asked is not None and self.refusals <= RETRIES
            return self.within(asked or 0.0, RETRY_BUDGET) if short else None
        if asked is None and status != 429:
            if not self.safe:
                return None
            self.doubtful = True
        pause = max(asked or 0.0, backoff(self.refusals))
        # An API server that always answers 500 will continue to: a webhook fails, for example.
        return self.within(pause, RETRY_BUDGET if status == 500 else AWAY)

    def within(self, pause: float, budget: float) -> float | None:
        return pause if time.monotonic() - self.started + pause <= budget else None

    def is_noticeable(self, pause: float) -> bool:
        """Whether the waits take so long that the user should know why."""
        return time.monotonic() - self.started + pause > SILENT


def retry_after(headers: Mapping[str, str]) -> float | None:
    """Return the seconds that a server requests, None if it requests none; a date counts as one."""
    header = headers.get("Retry-After")
    if header is None:
        return None
    return float(header) if re.fullmatch(r"[0-9]{1,9}", header) else 1.0


def backoff(number: int) -> float:
    """Return the pause before another attempt, from 1."""
    return min(FIRST_PAUSE * 2.0 ** min(number - 1, 10), LONGEST_PAUSE)

"""When a request is sent again: after a lost answer, a busy server, an unreachable server.

By default, a request waits for seconds. Long work (a deploy) waits longer: `Endurance` waits for an
API server that restarts, reports it once, and ends when the user asks for it.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Mapping

import attrs

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
        """Return a pause if there is time for it."""
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

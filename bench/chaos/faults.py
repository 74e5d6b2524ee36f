"""Which request of a command meets which fault: pure, and the same for a seed in any order."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from random import Random
from typing import Any, Literal

import attrs

#: Instead of an answer; the request never arrives.
BEFORE = ("reset", "hang-up", "silent", "409", "410", "429", "500", "503", "503 page")
#: After the API server has executed the request.
AFTER = ("lost", "cut", "slow", "late 500", "late 503", "truncated")
#: Answers that the API server never gives, whether it has executed the request or not.
GARBAGE: Mapping[str, bytes] = {
    "empty": b"",
    "HTML": b"<html><body>Please log in</body></html>",
    "null": b"null",
    "list": b"[]",
    "bare object": b'{"kind": "Thing"}',
    "bad UTF-8": b'{"kind": "\xff\xfe"}',
    "number": b"7",
}
#: What happens to a watch.
STREAMS = ("null event", "odd event", "error event", "expired", "cut event", "end", "silent stream")
ODD_EVENTS: Mapping[str, bytes] = {
    "null event": b"null\n",
    "odd event": b'{"type": "ADDED", "object": {"kind": "Pod"}}\n',
    "error event": b'{"type": "ERROR", "object": [1]}\n',
    "expired": b'{"type": "ERROR", "object": {"code": 410, "message": "too old"}}\n',
    "cut event": b'{"type": "MODIFIED", "obj',
}
RETRY_AFTER = ("", "0", "1", "1", "-3", "soon", "²", "Wed, 21 Oct 2026 07:28:00 GMT")
Outage = Literal["reset", "silent", "503", "503 page"]


@attrs.frozen
class Fault:
    """What happens to one request.

    Attributes:
        word: one of the words above.
        forwarded: the API server gets the request.
        retry_after: the header of a 429, 500 or 503, "" for none.
        events: how many blocks of a stream pass before.
    """

    word: str
    forwarded: bool
    retry_after: str = ""
    events: int = 0


@attrs.frozen
class Weather:
    """All faults of one command.

    Attributes:
        rate: the probability that a request meets a fault.
        words: the faults that occur.
        outage: how the server is unreachable, for `seconds` from the `first` request; None: never.
    """

    seed: str
    rate: float
    words: Sequence[str]
    outage: Outage | None
    first: int
    seconds: float

    def is_away(self, number: int) -> bool:
        """Whether the outage begins with a request, counted from 0."""
        return self.outage is not None and number >= self.first

    def fault(self, method: str, path: str, time: int, *, stream: bool) -> Fault | None:
        """Return the fault of a request, the same however requests are ordered.

        Args:
            time: how often this very request was made before.
            stream: whether it is a watch.
        """
        dice = Random(f"{self.seed} {method} {path} {time} {stream}")
        if dice.random() >= self.rate:
            return None
        word = dice.choice(self.words)
        if stream and word in (*AFTER, *GARBAGE):
            word = dice.choice(STREAMS)
        forwarded = word in (*AFTER, *STREAMS) or (word in GARBAGE and dice.random() < 0.5)
        return Fault(word, forwarded, dice.choice(RETRY_AFTER), dice.randrange(3))


def draw_weather(seed: str) -> Weather:
    """Return the weather of a command: sometimes one kind of fault, sometimes all, or an outage."""
    dice = Random(f"weather {seed}")
    every = [*BEFORE, *AFTER, *GARBAGE]
    words = every if dice.random() < 0.5 else dice.sample(every, dice.randint(1, 3))
    rate = dice.choice((0.0, 0.02, 0.05, 0.1, 0.3))
    away: Sequence[Outage] = ("reset", "silent", "503", "503 page")
    outage = dice.choice(away) if rate == 0 or dice.random() < 0.2 else None
    return Weather(seed, rate, words, outage, dice.randrange(25), dice.uniform(0.2, 3.0))


def refusal(status: int) -> bytes:
    """Return the body of an API server's error."""
    reasons = {409: "Conflict", 410: "Expired", 429: "TooManyRequests", 500: "InternalError"}
    value: dict[str, Any] = {
        "kind": "Status",
        "apiVersion": "v1",
        "metadata": {},
        "status": "Failure",
        "message": f"injected {status}",
        "reason": reasons.get(status, "ServiceUnavailable"),
        "code": status,
    }
    return json.dumps(value).encode()

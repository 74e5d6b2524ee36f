"""The ROS 2 half: it asks the keeper of each pod what the processes there have noted.

Why: a participant of our own would have to subscribe to each topic to measure it, and can read no
middleware but DDS. It joins DDS only for topics whose content is wanted (/diagnostics, /tf).
"""

from __future__ import annotations

import json
import socket
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from http.client import HTTPConnection, HTTPException
from typing import TYPE_CHECKING, Any

from rigel_exporter.graph import Graph
from rigel_exporter.messages import Reader, cdr
from rigel_exporter.notes import Counters
from rigel_exporter.samples import Subscription

if TYPE_CHECKING:
    from rigel_exporter.dds import Domain

#: Ports of one address at which a keeper may be: pods of one machine's network share them.
PORTS = 4
#: Seconds for a connection, and bytes of an answer; more is not a keeper's.
ANSWER, LARGEST = 3.0, 8 << 20
_AT_ONCE = 16


class Ros2:
    """A release's ROS 2 nodes, by the keepers of its pods."""

    counts = True

    def __init__(self, keepers: Sequence[str], domain: Domain | None) -> None:
        """`keepers` are NAME:PORT; `domain` receives topics whose content is wanted."""
        self._keepers, self._domain = keepers, domain
        self._counters = Counters()

    def look(self) -> Graph:
        """Return the current graph; a pod that does not answer is not in it."""
        with ThreadPoolExecutor(_AT_ONCE) as pool:
            places = sorted({one for found in pool.map(_resolve, self._keepers) for one in found})
            answers = dict(zip(map(str, places), pool.map(_ask, places)))
        return self._counters.take({place: one for place, one in answers.items() if one})

    def subscribe(self, topic: str, keep: int = 0) -> Subscription:
        """Subscribe to a topic; nothing is received without DDS."""
        if self._domain:
            return self._domain.subscribe(topic, keep)
        return Subscription(topic, keep, lambda _: None)

    def read(self, payload: bytes) -> Reader:
        """Return a reader of a kept payload."""
        return cdr(payload)

    def close(self) -> None:
        """Leave DDS."""
        if self._domain:
            self._domain.close()


def _resolve(keeper: str) -> list[tuple[str, int]]:
    """Return where the keepers of a NAME:PORT may be."""
    name, _, port = keeper.rpartition(":")
    try:
        found = {info[4][0] for info in socket.getaddrinfo(name, None, type=socket.SOCK_STREAM)}
    except OSError:
        return []
    return [(str(address), int(port) + i) for address in sorted(found) for i in range(PORTS)]


def _ask(place: tuple[str, int]) -> dict[str, Any] | None:
    """Return what a keeper answers, None if none is there."""
    try:
        with closing(HTTPConnection(*place, timeout=ANSWER)) as connection:
            connection.request("GET", "/notes")
            answer = connection.getresponse()
            found = json.loads(answer.read(LARGEST)) if answer.status == 200 else None
    except (OSError, HTTPException, ValueError):
        return None
    return found if isinstance(found, dict) and "processes" in found else None

"""The DDS half: it joins a domain's discovery to read its graph, and subscribes to named topics.

A thread of its own always reads, acknowledges and announces, since others forget participants
that do not; `look` returns the current state. It subscribes to ros_discovery_info, as every tool of
ROS 2 does, and to the named topics, best effort. dds_participant.py has the protocol, dds_ways.py
the sockets.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from rigel_exporter import messages
from rigel_exporter.dds_discovery import ENDPOINTS, SUPER_CLIENT
from rigel_exporter.dds_participant import LEASE, NAME, Participant
from rigel_exporter.dds_view import graph
from rigel_exporter.dds_ways import Resolver, Sockets, addresses
from rigel_exporter.graph import Graph
from rigel_exporter.samples import Subscription
from rigel_inpod import rtps
from rigel_inpod.spdp import Announcement, Place

T = TypeVar("T")

_FIRST = 0.2  # seconds between the first few: packets get lost while a network comes up
_FIRSTS = 5
_TICK = 1.0
_AGAIN = 10.0  # seconds between two looks for more peers, and for other interfaces
_PERIODS = {"announce": 3.0, "tick": _TICK, "ask": _AGAIN, "interfaces": _AGAIN}
_SERVER_PORT = 11811
_PEER_PORTS = 8  # how many participants to look for at a peer's address


class Domain:
    """A DDS domain, seen by a participant of it."""

    counts = False

    def __init__(
        self,
        domain: int = 0,
        *,
        mode: str = "multicast",
        interface: str | None = None,
        peers: Sequence[str] = (),
        servers: Sequence[str] = (),
        name: str = NAME,
    ) -> None:
        """Nothing is sent before `start`.

        Args:
            domain: its number.
            mode: `peers` (each is sent announcements), `discovery-server`, or multicast.
            interface: the only one to use; all except the loopback if left out.
            peers: names or addresses.
            servers: HOST:PORT of discovery servers.
            name: what a tool that lists participants shows.
        """
        self._domain, self._mode, self._interface = domain, mode, interface
        self._servers = (
            dict(_place(server) for server in servers) if mode == "discovery-server" else {}
        )
        self._resolver = Resolver(list(self._servers) if self._servers else peers)
        self._sockets: Sockets | None = None
        self._found: dict[str, str] = {}
        announcement = Announcement(
            os.urandom(12), domain=domain, name=name, lease=LEASE, endpoints=ENDPOINTS
        )
        if mode == "discovery-server":
            announcement = announcement._replace(vendor=rtps.FAST_DDS, properties=SUPER_CLIENT)
        self._participant = Participant(announcement, self._send)
        self._lock, self._end = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="dds", daemon=True)

    def start(self) -> None:
        """Join; wait for an interface that does not exist yet."""
        self._thread.start()

    def look(self) -> Graph:
        """Return the current graph; raises as `inspect`."""
        return self.inspect(lambda known: graph(known.peers.values(), known.writers, known.readers))

    def inspect(self, view: Callable[[Participant], T]) -> T:
        """Return a function's result for the current state, which does not change meanwhile.

        Raises:
            RuntimeError: the thread has ended, so the state would never change again.
        """
        if self._thread.ident and not self._thread.is_alive():
            raise RuntimeError("the thread that listens to DDS has ended")
        with self._lock:
            return view(self._participant)

    def subscribe(self, topic: str, keep: int = 0) -> Subscription:
        """Subscribe to a topic, and keep that many of its latest payloads."""
        with self._lock:
            return self._participant.hear(topic, keep, self._leave)

    def read(self, payload: bytes) -> messages.Reader:
        """Return a reader of a kept payload."""
        return messages.cdr(payload)

    def close(self) -> None:
        """Leave the domain, and announce that."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join()
        self._resolver.close()

    def _leave(self, subscription: Subscription) -> None:
        with self._lock:
            self._participant.leave(subscription)

    def _send(self, message: bytes, places: Sequence[Place]) -> None:
        if self._sockets:
            self._sockets.send(message, places)

    def _reach(self) -> None:
        """Use the current addresses of the servers."""
        found = self._resolver.found
        self._participant.servers = [
            (found[name], port) for name, port in self._servers.items() if name in found
        ]

    def _run(self) -> None:
        while not self._end.is_set():
            if self._open():
                self._stay()
            elif not self._end.wait(_TICK):
                with self._lock:
                    self._participant.tick(time.monotonic())  # forgets participants that are silent

    def _open(self) -> bool:
        self._found = addresses(self._interface)
        if not self._found:
            return False
        try:
            sockets = Sockets(self._domain, self._found, is_multicast=self._mode == "multicast")
        except OSError:
            return False
        with self._lock:
            self._sockets, participant = sockets, self._participant
            participant.own = participant.own._replace(
                meta=tuple(sockets.meta), data=tuple(sockets.data)
            )
        return True

    def _stay(self) -> None:
        """Take part until the end, or until the interfaces change."""
        sockets, buffer = self._sockets, bytearray(65536)
        assert sockets is not None
        now = time.monotonic()
        timers = _Timers(now)
        while not self._end.is_set() and not self._has_moved(timers, now):
            for size, source in sockets.receive(buffer, timers.next - now):
                self._take(memoryview(buffer)[:size], source)
            now = time.monotonic()
            with self._lock:
                if timers.is_due("announce", now):
                    self._reach()
                    sockets.send(self._participant.announcement(), self._list_targets())
                if timers.is_due("ask", now):
                    sockets.send(self._participant.announcement(), self._list_peer_places())
                if timers.is_due("tick", now):
                    self._participant.tick(now)
        with self._lock:
            if self._end.is_set():
                sockets.send(self._participant.farewell(), self._list_targets())
            self._sockets = None
        sockets.close()

    def _take(self, message: memoryview, source: str) -> None:
        try:
            with self._lock:
                self._participant.take(message, source, time.monotonic(), time.time())
        except rtps.Malformed:
            return  # another program's packet, or a broken one

    def _has_moved(self, timers: _Timers, now: float) -> bool:
        return timers.is_due("interfaces", now) and addresses(self._interface) != self._found

    def _list_targets(self) -> list[Place]:
        if self._mode == "multicast":
            return [(rtps.GROUP, rtps.announcement_port(self._domain))]
        if self._mode == "discovery-server":
            return list(self._participant.servers)
        return [place for peer in self._participant.peers.values() for place in peer.places]

    def _list_peer_places(self) -> list[Place]:
        """Return the addresses at which peers may be."""
        if self._mode != "peers":
            return []
        ports = [rtps.participant_port(self._domain, i) for i in range(_PEER_PORTS)]
        return [(address, port) for address in self._resolver.found.values() for port in ports]


class _Timers:
    """The times of periodic tasks; `next` is the earliest, in seconds of a monotonic clock."""

    def __init__(self, now: float) -> None:
        self._settled = now + _FIRSTS * _FIRST
        self._due = {"announce": now, "ask": now, "tick": now + _TICK, "interfaces": now + _AGAIN}

    @property
    def next(self) -> float:
        return min(self._due.values())

    def is_due(self, name: str, now: float) -> bool:
        """Whether a task is due; if so, it is scheduled again."""
        if now < self._due[name]:
            return False
        is_first = now < self._settled and name in ("announce", "ask")
        self._due[name] = now + (_FIRST if is_first else _PERIODS[name])
        return True


def _place(server: str) -> tuple[str, int]:
    """Return (name, port) of HOST:PORT."""
    name, _, port = server.rpartition(":")
    return (name, int(port)) if name else (server, _SERVER_PORT)

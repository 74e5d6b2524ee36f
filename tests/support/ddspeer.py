"""Another DDS participant on the loopback: a socket that announces itself and hears others."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rigel_inpod import rtps, spdp


def announced(message: bytes) -> list[tuple[spdp.Announcement, bool]]:
    """Return (who it is, whether it leaves) of each announcement in a message."""
    found = []
    for kind, flags, body in rtps.submessages(message):
        if kind == rtps.DATA and body[8:12] == rtps.SPDP_WRITER:
            _, _, payload, status, key = rtps.read_data(body, flags)
            if not status:
                told = spdp.participant(payload)._replace(vendor=message[6:8])
            else:
                guid = spdp.Parameters(payload).raw(spdp.PID_GUID) if payload else key
                told = spdp.Announcement((guid or message[8:20])[:12], message[6:8])
            found.append((told, bool(status)))
    return found


def some_domain() -> int:
    """Return a domain that hardly anyone else on this machine is in, nor in the one after it.

    The processes of one test run have one each; from 102 on ports are the system's to give.
    """
    process = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    return 62 + (os.getppid() + process) % 19 * 2


class Peer:
    """A participant at its domain's first port; `heard` is what others announced to it."""

    def __init__(self, domain: int, name: str) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", rtps.participant_port(domain, 0)))
        self.socket.settimeout(0.05)
        place = (self.socket.getsockname(),)
        self.told = spdp.Announcement(
            os.urandom(12), domain=domain, name=name, meta=place, data=place
        )
        self.heard: list[tuple[spdp.Announcement, bool]] = []

    def answer(self) -> None:
        """Take in what has come, and tell each of its senders of oneself."""
        while True:
            try:
                message = self.socket.recv(65536)
            except TimeoutError:
                return
            found = announced(message)
            self.heard += found
            for told, leaves in found:
                if not leaves:
                    self.socket.sendto(spdp.announcement(self.told), told.meta[0])

    def leave(self, told: spdp.Announcement) -> None:
        """Tell a participant that this one is gone."""
        self.socket.sendto(spdp.farewell(self.told.prefix), told.meta[0])

    def until(self, condition: Callable[[], object], what: str, seconds: float = 60) -> None:
        """Answer until a condition holds."""
        end = time.monotonic() + seconds
        while not condition():
            self.answer()
            assert time.monotonic() < end, f"after {seconds} s still not: {what}"


@contextmanager
def peer(domain: int, name: str = "other") -> Iterator[Peer]:
    """Make a participant for a while."""
    found = Peer(domain, name)
    try:
        yield found
    finally:
        found.socket.close()

"""Carries frames between interfaces of this computer and a pod's relay.

The format is that of src/rigel_inpod/join.py.
"""

from __future__ import annotations

import io
import json
import os
import select
import struct
import threading
from collections.abc import Sequence
from contextlib import suppress
from typing import Any

HEAD = struct.Struct(">BI")
LARGEST = 10 + 65550
#: Seconds between two signs of life; the relay ends without one for 30 s.
ALIVE = 5.0
IPV6 = b"\x86\xdd"


class Link(io.BufferedIOBase):
    """The relay's output, as a file that is written to, and its input.

    Attributes:
        network: what the relay has printed first; set when `begun` is.
    """

    def __init__(self) -> None:
        super().__init__()
        self.begun = threading.Event()
        self.network: dict[str, Any] = {}
        self.stdin, self._input = os.pipe()
        self._ended, self._end = os.pipe()
        self._rest = bytearray()
        self._interfaces: Sequence[int] = ()

    def write(self, data: Any) -> int:
        """Take a part of what the relay prints; frames go to their interfaces."""
        self._rest += data
        if not self.begun.is_set():
            line, found, rest = self._rest.partition(b"\n")
            if found:
                self.network, self._rest = json.loads(line), rest
                self.begun.set()
            return len(data)
        place = 0
        while len(self._rest) >= place + HEAD.size:
            number, size = HEAD.unpack_from(self._rest, place)
            end = place + HEAD.size + size
            if len(self._rest) < end:
                break
            if self._interfaces:
                self._give(number, self._rest[place + HEAD.size : end])
            place = end
        del self._rest[:place]
        return len(data)

    def _give(self, number: int, frame: bytearray) -> None:
        with suppress(OSError):  # as a network that has lost it
            os.write(self._interfaces[number], frame)

    def give_to(self, interfaces: Sequence[int]) -> None:
        """Give frames to these interfaces, named by their descriptors; before, they are lost."""
        self._interfaces = interfaces

    def carry(self, interfaces: Sequence[int]) -> None:
        """Carry the frames of interfaces both ways, until end() or the end of the session."""
        self.give_to(interfaces)
        numbers = {interface: number for number, interface in enumerate(interfaces)}
        watched = [*interfaces, self._ended]
        with suppress(OSError):  # the session has ended
            while self._ended not in (ready := select.select(watched, [], [], ALIVE)[0]):
                frames = [(numbers[one], os.read(one, LARGEST)) for one in ready]
                carried = [(number, frame) for number, frame in frames if frame[22:24] != IPV6]
                for number, frame in carried:
                    self._send(HEAD.pack(number, len(frame)) + frame)
                if not carried:
                    self._send(HEAD.pack(0, 0))

    def _send(self, data: bytes) -> None:
        while data:
            data = data[os.write(self._input, data) :]

    def end(self) -> None:
        """Let the relay end."""
        os.close(self._end)
        os.close(self._input)

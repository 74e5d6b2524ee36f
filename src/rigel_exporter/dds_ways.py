"""How a participant sends and receives packets: interfaces, sockets, and the names of peers.

Why: each network mode of an application has its own way into the domain: a multicast group, a list
of peers, discovery servers. It must not depend on the contents of packets.
"""

from __future__ import annotations

import selectors
import socket
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence

from rigel_inpod import rtps
from rigel_inpod.interfaces import IP_MULTICAST_ALL, address_of, membership
from rigel_inpod.spdp import Place

_ROOM = 4 << 20  # bytes requested for a socket's buffer; the kernel may give less
_AT_ONCE = 64  # packets that are read from a socket before the next socket
_AGAIN = 10.0  # seconds after which names are resolved again


def addresses(interface: str | None) -> dict[str, str]:
    """Return name -> IPv4 address of an interface, or of all except the loopback.

    If the loopback is the only one with an address, it is returned.
    """
    every = [interface] if interface else [name for _, name in socket.if_nameindex()]
    found = {name: address_of(name) for name in every}
    usable = {name: address for name, address in found.items() if address}
    if len(usable) > 1:
        usable.pop("lo", None)
    return usable


class Sockets:
    """The sockets of a participant: on each interface one for discovery and one for samples.

    Attributes:
        meta, data: their addresses, one for each interface.
    """

    def __init__(self, domain: int, found: Mapping[str, str], *, is_multicast: bool) -> None:
        """`found` is interface -> address.

        Raises:
            OSError: an address no longer exists.
        """
        self._selector = selectors.DefaultSelector()
        self._mouths: dict[str, socket.socket] = {}
        self.meta: list[Place] = []
        self.data: list[Place] = []
        try:
            for name, address in found.items():
                self._open(domain, name, address, is_multicast=is_multicast)
        except OSError:
            self.close()
            raise

    def _open(self, domain: int, name: str, address: str, *, is_multicast: bool) -> None:
        joined = membership(rtps.GROUP, name)
        mouth = self._add(_bind(address, 0))
        mouth.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, joined)
        self._mouths[address] = mouth
        self.meta.append(mouth.getsockname())
        self.data.append(self._add(_bind(address, 0)).getsockname())
        if is_multicast:
            ear = self._add(_bind(rtps.GROUP, rtps.announcement_port(domain)))
            ear.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)
            ear.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)

    def _add(self, found: socket.socket) -> socket.socket:
        found.setblocking(False)
        self._selector.register(found, selectors.EVENT_READ)
        return found

    def send(self, message: bytes, places: Iterable[Place]) -> None:
        """Send a message through every interface; it is lost if there is no route."""
        for place in places:
            for mouth in self._mouths.values():
                try:
                    mouth.sendto(message, place)
                except OSError:
                    continue

    def receive(self, buffer: bytearray, seconds: float) -> Iterator[tuple[int, str]]:
        """Yield (size, sender's address) of packets that arrive in `buffer` in some seconds."""
        for key, _ in self._selector.select(max(seconds, 0)):
            ready = key.fileobj
            assert isinstance(ready, socket.socket)
            for _ in range(_AT_ONCE):
                try:
                    size, source = ready.recvfrom_into(buffer)
                except OSError:
                    break
                yield size, source[0]

    def close(self) -> None:
        """Close them all."""
        for key in list(self._selector.get_map().values()):
            assert isinstance(key.fileobj, socket.socket)
            key.fileobj.close()
        self._selector.close()


def _bind(address: str, port: int) -> socket.socket:
    found = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    found.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _ROOM)
    if port:
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    found.bind((address, port))
    return found


class Resolver:
    """Keeps the addresses of names, so an unreachable name server does not block others."""

    def __init__(self, names: Sequence[str]) -> None:
        self.found: dict[str, str] = {}
        self._names, self._end = names, threading.Event()
        if names:
            threading.Thread(target=self._run, name="dds-names", daemon=True).start()

    def close(self) -> None:
        """Stop resolving."""
        self._end.set()

    def _run(self) -> None:
        while not self._end.is_set():
            for name in self._names:
                try:
                    self.found[name] = socket.gethostbyname(name)
                except OSError:
                    continue  # the last addresses may still be right
            self._end.wait(_AGAIN if len(self.found) == len(self._names) else 1.0)

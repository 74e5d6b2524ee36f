"""Reads messages: CDR, in either byte order, and a few types.

Why: a header's stamp, /diagnostics, /clock, /tf and the nodes of a participant become metrics;
nothing else of a message is read. It must not depend on RTPS.

All functions raise `Unreadable` if a payload is not of the expected type.
"""

from __future__ import annotations

from struct import error, unpack_from
from typing import Any, Union

from rigel_exporter.dds_headers import is_listed, is_stamped

Payload = Union[bytes, memoryview]
_GIDS = (16, 24)  # bytes of a GUID in ros_discovery_info: since iron, before it
_GUID = 16
_DELIMITED = (0x08, 0x09)  # XCDR2 with the size of a struct in front of it
_MOST = 10_000  # elements of a sequence that are read


class Unreadable(ValueError):
    """A payload is not of the announced type."""


class _Cdr:
    """A payload that is read from its beginning to its end."""

    def __init__(self, payload: Payload) -> None:
        if len(payload) < 4:
            raise Unreadable("a payload without its encapsulation")
        self.raw, self.at, kind = payload, 4, payload[1]
        self.order = "<" if kind & 1 else ">"
        self.widest = 4 if kind >= 0x06 else 8  # the alignment of doubles
        if kind in _DELIMITED:
            self.at = 8

    def take(self, code: str, size: int) -> Any:
        """Return a number of `size` bytes."""
        step = min(size, self.widest)
        self.at += -(self.at - 4) % step
        try:
            (value,) = unpack_from(self.order + code, self.raw, self.at)
        except error as cause:
            raise Unreadable("a payload ends before it should") from cause
        self.at += size
        return value

    def count(self) -> int:
        """Return the length of a sequence."""
        length = int(self.take("I", 4))
        if length > min(_MOST, len(self.raw)):
            raise Unreadable(f"a sequence of {length} in {len(self.raw)} bytes")
        return length

    def text(self) -> str:
        length = int(self.take("I", 4))
        if length > len(self.raw) - self.at:
            raise Unreadable("a text ends after its payload")
        raw = bytes(self.raw[self.at : self.at + length])
        self.at += length
        return raw.rstrip(b"\0").decode("utf-8", "replace")

    def time(self) -> float:
        """Return a builtin_interfaces/Time in seconds."""
        seconds = self.take("i", 4)
        return float(seconds + self.take("I", 4) / 1e9)

    def guid(self, size: int) -> bytes:
        """Return a GUID of so many bytes; those of the longer form end with zeros."""
        self.at += size
        return bytes(self.raw[self.at - size : self.at - size + _GUID])

    def skip(self, size: int) -> None:
        self.at += size


def stamp(payload: Payload, type_name: str) -> float | None:
    """Return the header's stamp in seconds, None for a type that does not begin with a header.

    The first fragment of a message is enough. An empty list of stamped things has no stamp.
    """
    if not is_stamped(type_name):
        return None
    cdr = _Cdr(payload)
    if is_listed(type_name) and cdr.take("I", 4) == 0:
        return None
    return cdr.time()


def clock(payload: Payload) -> float:
    """Return the time of a rosgraph_msgs/Clock in seconds."""
    return _Cdr(payload).time()


def diagnostics(payload: Payload) -> list[tuple[str, str, int]]:
    """Return (name, hardware id, level) of each status of a diagnostic_msgs/DiagnosticArray."""
    cdr = _Cdr(payload)
    cdr.time()
    cdr.text()
    return [_status(cdr) for _ in range(cdr.count())]


def _status(cdr: _Cdr) -> tuple[str, str, int]:
    level, name, _, hardware = cdr.take("B", 1), cdr.text(), cdr.text(), cdr.text()
    for _ in range(2 * cdr.count()):  # keys and values
        cdr.text()
    return name, hardware, level


def transforms(payload: Payload) -> list[tuple[str, str, float]]:
    """Return (parent, child, stamp in seconds) of each transform of a tf2_msgs/TFMessage."""
    cdr = _Cdr(payload)
    return [_transform(cdr) for _ in range(cdr.count())]


def _transform(cdr: _Cdr) -> tuple[str, str, float]:
    when, parent, child = cdr.time(), cdr.text(), cdr.text()
    for _ in range(7):  # a vector and a quaternion
        cdr.take("d", 8)
    return parent, child, when


def nodes(payload: Payload) -> dict[str, frozenset[bytes]]:
    """Return the nodes of a participant: name with namespace -> its endpoints' GUIDs.

    A rmw_dds_common/ParticipantEntitiesInfo does not contain the length of its GUIDs: it is the one
    with which the payload ends where it should.
    """
    for size in _GIDS:
        try:
            return _nodes(_Cdr(payload), size)
        except Unreadable as cause:
            reason = cause
    raise reason


def _nodes(cdr: _Cdr, gid: int) -> dict[str, frozenset[bytes]]:
    cdr.skip(gid)
    found: dict[str, frozenset[bytes]] = {}
    for _ in range(cdr.count()):
        namespace, name = cdr.text(), cdr.text()
        full = namespace.rstrip("/") + "/" + name
        if not namespace.startswith("/") or not name:
            raise Unreadable(f"not a node's name: {full!r}")
        guids = [cdr.guid(gid) for _ in range(2) for _ in range(cdr.count())]  # readers, writers
        found[full] = found.get(full, frozenset()).union(guids)
    if not 0 <= len(cdr.raw) - cdr.at < 4:  # writers fill up to four bytes
        raise Unreadable("nodes do not end where their payload does")
    return found

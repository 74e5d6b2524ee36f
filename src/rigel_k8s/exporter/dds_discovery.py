"""Participants and endpoints as discovery tells them, read and written as parameter lists.

Why: SPDP and SEDP (DDSI-RTPS 2.5: 8.5, 9.6.3) carry all that a graph is made of. Bytes in, plain
data out; it must not know sockets, time, or what becomes of what it reads.
"""

from __future__ import annotations

from struct import error, pack, unpack_from
from typing import NamedTuple, Union

from rigel_k8s.inpod import rtps

__all__ = [
    "PUBLICATIONS_READER",
    "PUBLICATIONS_WRITER",
    "SUBSCRIPTIONS_READER",
    "SUBSCRIPTIONS_WRITER",
    "SUPER_CLIENT",
    "Endpoint",
    "Place",
    "Told",
    "endpoint",
    "key_of",
    "participant",
    "participant_payload",
    "reader_key",
    "reader_payload",
]

PUBLICATIONS_WRITER, PUBLICATIONS_READER = b"\x00\x00\x03\xc2", b"\x00\x00\x03\xc7"
SUBSCRIPTIONS_WRITER, SUBSCRIPTIONS_READER = b"\x00\x00\x04\xc2", b"\x00\x00\x04\xc7"

#: We announce ourselves and our readers, and want to know all others; we have no writers.
ENDPOINTS = 0x01 | 0x02 | 0x08 | 0x10 | 0x20
HAS_PUBLICATIONS, HAS_SUBSCRIPTIONS, HAS_SUBSCRIPTIONS_READER = 0x04, 0x10, 0x20

PID_TOPIC, PID_TYPE, PID_RELIABILITY, PID_DURABILITY = 0x0005, 0x0007, 0x001A, 0x001D
PID_OWNERSHIP, PID_PARTITION, PID_UNICAST, PID_PROPERTIES = 0x001F, 0x0029, 0x002F, 0x0059
PID_ENDPOINT, PID_REPRESENTATION = 0x005A, 0x0073
#: Who a discovery server tells everything, and in which version of its protocol.
SUPER_CLIENT = (("PARTICIPANT_TYPE", "SUPER_CLIENT"), ("DS_VERSION", "2.0"))
BEST_EFFORT, RELIABLE = 1, 2
VOLATILE, TRANSIENT_LOCAL = 0, 1
MOST_LOCATORS = 8

#: An IPv4 address and a UDP port.
Place = tuple[str, int]
Payload = Union[bytes, memoryview]


class Told(NamedTuple):
    """What a participant announces of itself; `lease` in seconds."""

    prefix: bytes
    vendor: bytes = rtps.UNKNOWN
    domain: int | None = None
    name: str = ""
    user_data: str = ""
    properties: tuple[tuple[str, str], ...] = ()
    meta: tuple[Place, ...] = ()
    data: tuple[Place, ...] = ()
    lease: float = 100.0
    endpoints: int = 0


class Endpoint(NamedTuple):
    """A writer or a reader; `quality` is what a reader must repeat to be matched with it."""

    guid: bytes
    topic: str = ""
    type: str = ""
    is_reliable: bool = False
    is_local: bool = False
    quality: tuple[tuple[int, bytes], ...] = ()

    @property
    def is_keyed(self) -> bool:
        """Whether its topic has keys: both ends must agree."""
        return self.guid[15] & 0x0F in (0x02, 0x07)


def participant(payload: Payload) -> Told:
    """Read an announcement.

    Raises:
        rtps.Malformed: it is none.
    """
    found = _Reading(payload)
    lease = found.get(rtps.PID_LEASE, "iI", (100, 0))
    domain = found.get(rtps.PID_DOMAIN, "I", (None,))[0]
    guid = found.raw(rtps.PID_GUID)
    if len(guid) < 12:
        raise rtps.Malformed("an announcement of nobody")
    return Told(
        prefix=guid[:12],
        vendor=found.raw(rtps.PID_VENDOR)[:2],
        domain=domain,
        name=found.text(rtps.PID_NAME),
        user_data=found.text(rtps.PID_USER_DATA),
        properties=found.properties(),
        meta=found.places(rtps.PID_META_UNICAST),
        data=found.places(rtps.PID_DEFAULT_UNICAST),
        lease=float(lease[0]) if lease[0] >= 0 else 1e9,
        endpoints=found.get(rtps.PID_ENDPOINTS, "I", (0,))[0],
    )


def endpoint(payload: Payload) -> Endpoint:
    """Read what SEDP tells of a writer or reader.

    Raises:
        rtps.Malformed: it is no such thing.
    """
    found = _Reading(payload)
    guid = found.raw(PID_ENDPOINT)
    if len(guid) != 16:
        raise rtps.Malformed("an endpoint without a GUID")
    repeated = (PID_OWNERSHIP, PID_PARTITION)
    return Endpoint(
        guid=guid,
        topic=found.text(PID_TOPIC),
        type=found.text(PID_TYPE),
        is_reliable=found.get(PID_RELIABILITY, "I", (BEST_EFFORT,))[0] == RELIABLE,
        is_local=found.get(PID_DURABILITY, "I", (VOLATILE,))[0] >= TRANSIENT_LOCAL,
        quality=tuple((pid, found.little(pid)) for pid in repeated if found.raw(pid)),
    )


def key_of(payload: Payload) -> bytes:
    """Return the GUID that a payload of nothing but a key names, empty where it names none."""
    found = _Reading(payload)
    return found.raw(PID_ENDPOINT) or found.raw(rtps.PID_GUID)


class _Reading:
    """A payload's parameters."""

    def __init__(self, payload: Payload) -> None:
        if len(payload) < 4 or payload[1] not in (0x02, 0x03):
            raise rtps.Malformed("no parameter list")
        self.order = "<" if payload[1] & 1 else ">"
        try:
            pairs, _ = rtps.parameter_list(payload, 4, self.order)
        except error as cause:
            raise rtps.Malformed("a parameter list without its end") from cause
        self.found: dict[int, list[bytes]] = {}
        for pid, value in pairs:
            self.found.setdefault(pid, []).append(bytes(value))

    def raw(self, pid: int) -> bytes:
        return self.found.get(pid, [b""])[0]

    def get(self, pid: int, code: str, default: tuple[object, ...]) -> tuple[int, ...]:
        try:
            return unpack_from(self.order + code, self.raw(pid))
        except error:
            return default  # type: ignore[return-value]

    def text(self, pid: int) -> str:
        return self._text(self.raw(pid), 0)[0]

    def _text(self, raw: bytes, at: int) -> tuple[str, int]:
        """Return (the text at a place, where the next thing begins)."""
        if len(raw) < at + 4:
            return "", len(raw)
        (size,) = unpack_from(self.order + "I", raw, at)
        end = at + 4 + size
        return raw[at + 4 : end].rstrip(b"\0").decode("utf-8", "replace"), end + -end % 4

    def properties(self) -> tuple[tuple[str, str], ...]:
        raw, found, at = self.raw(PID_PROPERTIES), [], 4
        while at < len(raw):
            name, at = self._text(raw, at)
            value, at = self._text(raw, at)
            found.append((name, value))
        return tuple(found)

    def places(self, pid: int) -> tuple[Place, ...]:
        """Return where UDP over IPv4 reaches it."""
        found = []
        for raw in self.found.get(pid, [])[:MOST_LOCATORS]:
            if len(raw) >= 24:
                kind, port = unpack_from(self.order + "iI", raw)
                if kind == rtps.UDP4 and 0 < port < 65536:
                    found.append((".".join(str(n) for n in raw[20:24]), port))
        return tuple(found)

    def little(self, pid: int) -> bytes:
        """Return a value of words and texts in little-endian order, as we write everything."""
        raw = self.raw(pid)
        return raw if self.order == "<" else _turned(raw, pid)


def _turned(raw: bytes, pid: int) -> bytes:
    """Turn the byte order of an ownership's word, or of a partition's list of texts."""
    if len(raw) < 4:
        raise rtps.Malformed("a quality of service without a value")
    value = pack("<I", *unpack_from(">I", raw))
    at = 4
    while pid == PID_PARTITION and at + 4 <= len(raw):
        (size,) = unpack_from(">I", raw, at)
        padding = b"\0" * (-size % 4)
        value += pack("<I", size) + raw[at + 4 : at + 4 + size] + padding
        at += 4 + size + len(padding)
    return value


def participant_payload(own: Told) -> bytes:
    """Write our announcement."""
    name = own.name.encode() + b"\0"
    pairs = [
        (rtps.PID_VERSION, rtps.VERSION),
        (rtps.PID_VENDOR, own.vendor),
        (rtps.PID_GUID, own.prefix + rtps.PARTICIPANT),
        (rtps.PID_DOMAIN, pack("<I", own.domain or 0)),
        *((rtps.PID_META_UNICAST, rtps.locator(*place)) for place in own.meta),
        *((rtps.PID_DEFAULT_UNICAST, rtps.locator(*place)) for place in own.data),
        (rtps.PID_LEASE, pack("<iI", int(own.lease), 0)),
        (rtps.PID_ENDPOINTS, pack("<I", own.endpoints)),
        (rtps.PID_NAME, pack("<I", len(name)) + name),
    ]
    if own.properties:
        pairs.append((PID_PROPERTIES, _properties(own.properties)))
    return bytes(rtps.serialized(pairs))


def _properties(pairs: tuple[tuple[str, str], ...]) -> bytes:
    texts = [text for pair in pairs for text in pair]
    return pack("<I", len(pairs)) + b"".join(_text(text) for text in texts)


def _text(text: str) -> bytes:
    raw = text.encode() + b"\0"
    return pack("<I", len(raw)) + bytes(rtps.padded(raw))


def reader_payload(own: Endpoint) -> bytes:
    """Write what SEDP tells of a reader of ours; it takes both encodings, XCDR 1 and 2."""
    reliability = RELIABLE if own.is_reliable else BEST_EFFORT
    durability = TRANSIENT_LOCAL if own.is_local else VOLATILE
    pairs = [
        (PID_ENDPOINT, own.guid),
        (rtps.PID_GUID, own.guid[:12] + rtps.PARTICIPANT),
        (PID_TOPIC, _text(own.topic)),
        (PID_TYPE, _text(own.type)),
        (PID_RELIABILITY, pack("<IiI", reliability, 0, 0)),
        (PID_DURABILITY, pack("<I", durability)),
        (PID_REPRESENTATION, pack("<Ihhh", 2, 0, 2, 0)),
        *own.quality,
    ]
    return bytes(rtps.serialized(pairs))


def reader_key(own: Endpoint) -> bytes:
    """Write which reader of ours is gone."""
    return bytes(rtps.serialized([(PID_ENDPOINT, own.guid)]))

"""What a DDS participant announces of itself (SPDP), read and written as parameter lists.

Why: the exporter announces itself and reads others. The probe does neither, so it does not load
this. Bytes in, plain data out; no socket, no clock. DDSI-RTPS 2.5: 8.5.3 and 9.6.3. Python 3.6 and
newer, nothing but the standard library.
"""

from struct import error, pack, unpack_from
from typing import NamedTuple, Optional, Tuple

from . import rtps

PID_LEASE, PID_DOMAIN, PID_VERSION, PID_VENDOR = 0x0002, 0x000F, 0x0015, 0x0016
PID_USER_DATA, PID_DEFAULT_UNICAST, PID_META_UNICAST = 0x002C, 0x0031, 0x0032
PID_GUID, PID_ENDPOINTS, PID_PROPERTIES, PID_NAME = 0x0050, 0x0058, 0x0059, 0x0062
MOST_PLACES, MOST_PROPERTIES = 8, 64
LONGEST = 1024  # bytes of a text that are read

#: An IPv4 address and a UDP port.
Place = Tuple[str, int]


class Announcement(NamedTuple):
    """What a participant announces of itself; `lease` in seconds.

    prefix: 12 bytes, unique for each participant; vendor: rtps.FAST_DDS for one that a discovery
    server must answer; meta, data: where it receives announcements, and samples.
    """

    prefix: bytes
    vendor: bytes = rtps.UNKNOWN
    domain: Optional[int] = None
    name: str = ""
    user_data: str = ""
    properties: Tuple[Tuple[str, str], ...] = ()
    meta: Tuple[Place, ...] = ()
    data: Tuple[Place, ...] = ()
    lease: float = 100.0
    endpoints: int = 0


class Parameters(object):
    """A payload's parameters: values by their ids."""

    def __init__(self, payload):
        """Raise rtps.Malformed if it has none."""
        if len(payload) < 4 or payload[1] not in (0x02, 0x03):
            raise rtps.Malformed("not a parameter list")
        self.order = "<" if payload[1] & 1 else ">"
        try:
            pairs, _ = rtps.parameter_list(payload, 4, self.order)
        except error:
            raise rtps.Malformed("a parameter list without its end")
        self.found = {}
        for pid, value in pairs:
            self.found.setdefault(pid, []).append(bytes(value))

    def raw(self, pid):
        """Return a value's bytes, empty if it is not there."""
        return self.found.get(pid, [b""])[0]

    def get(self, pid, code, default):
        """Return a value by its code in `struct`."""
        try:
            return unpack_from(self.order + code, self.raw(pid))
        except error:
            return default

    def text(self, pid):
        """Return a text, "" if it is not there."""
        return self._text(self.raw(pid), 0)[0]

    def _text(self, raw, at):
        """Return (the text at a position, where the next item begins)."""
        if len(raw) < at + 4:
            return "", len(raw)
        (size,) = unpack_from(self.order + "I", raw, at)
        end = at + 4 + size
        value = raw[at + 4 : min(end, at + 4 + LONGEST)].rstrip(b"\0")
        return value.decode("utf-8", "replace"), end + -end % 4

    def properties(self):
        """Return pairs of name and value."""
        raw, found, at = self.raw(PID_PROPERTIES), [], 4
        while at < len(raw) and len(found) < MOST_PROPERTIES:
            name, at = self._text(raw, at)
            value, at = self._text(raw, at)
            found.append((name, value))
        return tuple(found)

    def places(self, pid):
        """Return the addresses where UDP over IPv4 reaches it."""
        found = []
        for raw in self.found.get(pid, [])[:MOST_PLACES]:
            if len(raw) >= 24:
                kind, port = unpack_from(self.order + "iI", raw)
                if kind == rtps.UDP4 and 0 < port < 65536:
                    found.append((".".join(str(n) for n in raw[20:24]), port))
        return tuple(found)


def participant(payload):
    """Return the content of an announcement's payload.

    Raises:
        rtps.Malformed: it is not an announcement.
    """
    found = Parameters(payload)
    lease = found.get(PID_LEASE, "iI", (100, 0))
    guid = found.raw(PID_GUID)
    if len(guid) < 12:
        raise rtps.Malformed("an announcement without a participant")
    return Announcement(
        prefix=guid[:12],
        vendor=found.raw(PID_VENDOR)[:2],
        domain=found.get(PID_DOMAIN, "I", (None,))[0],
        name=found.text(PID_NAME),
        user_data=found.text(PID_USER_DATA),
        properties=found.properties(),
        meta=found.places(PID_META_UNICAST),
        data=found.places(PID_DEFAULT_UNICAST),
        lease=float(lease[0]) if lease[0] >= 0 else 1e9,
        endpoints=found.get(PID_ENDPOINTS, "I", (0,))[0],
    )


def announcement(own):
    """Return the message that announces a participant."""
    inline = rtps.parameters(rtps.identity(own.prefix, rtps.SPDP_WRITER, 1))
    ends = rtps.SPDP_READER, rtps.SPDP_WRITER
    data = rtps.data(*ends, 1, inline if own.vendor == rtps.FAST_DDS else b"", payload_of(own))
    return rtps.header(own.prefix, own.vendor) + data


def farewell(prefix, vendor=rtps.UNKNOWN):
    """Return the message that withdraws a participant's announcement."""
    guid = prefix + rtps.PARTICIPANT
    inline = rtps.parameters([(rtps.PID_KEY_HASH, guid), (rtps.PID_STATUS, rtps.GONE)])
    ends = rtps.SPDP_READER, rtps.SPDP_WRITER
    data = rtps.data(*ends, 2, inline, rtps.serialized([(PID_GUID, guid)]), is_key=True)
    return rtps.header(prefix, vendor) + data


def payload_of(own):
    """Return an announcement's payload."""
    pairs = [
        (PID_VERSION, rtps.VERSION),
        (PID_VENDOR, own.vendor),
        (PID_GUID, own.prefix + rtps.PARTICIPANT),
        (PID_DOMAIN, pack("<I", own.domain or 0)),
    ]
    pairs += [(PID_META_UNICAST, rtps.locator(*place)) for place in own.meta]
    pairs += [(PID_DEFAULT_UNICAST, rtps.locator(*place)) for place in own.data]
    pairs += [
        (PID_LEASE, pack("<iI", int(own.lease), 0)),
        (PID_ENDPOINTS, pack("<I", own.endpoints)),
        (PID_NAME, text(own.name)),
    ]
    if own.properties:
        texts = [text(part) for pair in own.properties for part in pair]
        pairs.append((PID_PROPERTIES, pack("<I", len(own.properties)) + b"".join(texts)))
    return rtps.serialized(pairs)


def text(value):
    """Return a text as a parameter's value."""
    raw = value.encode() + b"\0"
    return pack("<I", len(raw)) + rtps.padded(raw)

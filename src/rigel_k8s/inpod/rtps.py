"""RTPS, the protocol below every DDS: just enough to announce a participant and read others.

Why: whether ROS 2 nodes discover each other shows only on the wire, and images hold no tool for it.
Contract: bytes in, bytes out; no socket, no clock. Written after OMG's DDSI-RTPS 2.5: 8.3 messages,
9.4 their encoding, 8.5.3 and 9.6.3 participant announcements (SPDP), 9.6.1 ports and addresses.
Python 3.6 and newer, nothing but the standard library.
"""

from struct import error, pack, unpack_from

GROUP = "239.255.0.1"  # where participants announce themselves
SPDP_READER, SPDP_WRITER = b"\x00\x01\x00\xc7", b"\x00\x01\x00\xc2"
PARTICIPANT = b"\x00\x00\x01\xc1"
VERSION = b"\x02\x03"
UNKNOWN = b"\x00\x00"  # the vendor of what no vendor made
FAST_DDS = b"\x01\x0f"  # its discovery server talks with its own kind only
VENDORS = {
    0x0101: "RTI Connext",
    0x0102: "OpenSplice",
    0x0103: "OpenDDS",
    0x010B: "CoreDX",
    0x010F: "Fast DDS",
    0x0110: "Cyclone DDS",
    0x0111: "GurumDDS",
    0x0112: "RustDDS",
    0x0115: "Dust DDS",
}
UDP4 = 1  # a locator's kind

INFO_TS, INFO_DST, DATA, BEACON = (
    0x09,
    0x0E,
    0x15,
    0xE5,
)  # from 0x80 on a submessage is a vendor's own
LITTLE, INLINE, WITH_DATA, WITH_KEY = 0x01, 0x02, 0x04, 0x08

PID_LEASE, PID_DOMAIN, PID_VERSION, PID_VENDOR = 0x0002, 0x000F, 0x0015, 0x0016
PID_USER_DATA, PID_DEFAULT_UNICAST, PID_META_UNICAST = 0x002C, 0x0031, 0x0032
PID_META_MULTICAST, PID_GUID, PID_ENDPOINTS, PID_NAME = 0x0033, 0x0050, 0x0058, 0x0062
PID_KEY_HASH, PID_STATUS, PID_SENTINEL = 0x0070, 0x0071, 0x0001
PID_RELATED, PID_RELATED_FAST_DDS = 0x0083, 0x800F  # the identity of a sample

GONE = b"\x00\x00\x00\x03"  # disposed and unregistered; always big end first

#: We announce and detect participants, and have nothing else to match.
ENDPOINTS = 0x01 | 0x02


class Malformed(Exception):
    """These bytes are no RTPS message, or a broken one."""


def announcement_port(domain):
    """Return the UDP port of a domain's multicast announcements."""
    return 7400 + 250 * domain


def participant_port(domain, index):
    """Return the UDP port at which a domain's participant number `index` takes announcements."""
    return 7410 + 250 * domain + 2 * index


def domain_of(port):
    """Return the domain whose ports a port is one of, None where it is none's."""
    domain = (port - 7400) // 250
    return domain if 0 <= domain <= 232 else None


def announcement(prefix, domain, name, address, port, lease, vendor=UNKNOWN):
    """Return the announcement of a participant.

    Args:
        prefix: the 12 bytes that tell it from all others.
        address, port: where it takes answers.
        lease: seconds after which others may forget it.
        vendor: FAST_DDS for one that a discovery server is to answer.
    """
    place = locator(address, port)
    text = name.encode() + b"\0"
    told = [
        (PID_VERSION, VERSION),
        (PID_VENDOR, vendor),
        (PID_GUID, prefix + PARTICIPANT),
        (PID_DOMAIN, pack("<I", domain)),
        (PID_META_UNICAST, place),
        (PID_DEFAULT_UNICAST, place),
        (PID_LEASE, pack("<iI", lease, 0)),
        (PID_ENDPOINTS, pack("<I", ENDPOINTS)),
        (PID_NAME, pack("<I", len(text)) + text),
    ]
    flags, content = LITTLE | WITH_DATA, serialized(told)
    if vendor == FAST_DDS:
        sample = prefix + SPDP_WRITER + pack("<iI", 0, 1)
        inline = parameters([(PID_RELATED, sample), (PID_RELATED_FAST_DDS, sample)])
        flags, content = flags | INLINE, inline + content
    return header(prefix, vendor) + _data(flags, content, 1)


def farewell(prefix, vendor=UNKNOWN):
    """Return the message that takes a participant's announcement back."""
    key = [(PID_GUID, prefix + PARTICIPANT)]
    inline = parameters([(PID_KEY_HASH, prefix + PARTICIPANT), (PID_STATUS, GONE)])
    data = _data(LITTLE | INLINE | WITH_KEY, inline + serialized(key), 2)
    return header(prefix, vendor) + data


def beacon(prefix, text):
    """Return a message that every participant must ignore (8.3.4.1), and that carries a text."""
    body = padded(text.encode())
    return header(prefix, UNKNOWN) + pack("<BBH", BEACON, LITTLE, len(body)) + body


def beacon_text(message):
    """Return the text of a beacon, None where the message is none of ours."""
    for kind, _, body in submessages(message):
        if kind == BEACON and message[6:8] == UNKNOWN:
            return body.rstrip(b"\0").decode("utf-8", "replace")
    return None


def addressee(message):
    """Return the prefix of the participant that a message is for, None where it is for anybody."""
    return next((body for kind, _, body in submessages(message) if kind == INFO_DST), None)


def announced(message):
    """Return what each announcement in a message tells about a participant.

    prefix: hex, vendor: its name, domain: None where it is not told, name, user_data: texts,
    locators: the (address, port) pairs at which it takes announcements, lease: seconds,
    leaving: whether it is a farewell.

    Raises:
        Malformed: it is no RTPS message.
    """
    try:
        return [
            _participant(message, flags, body)
            for kind, flags, body in submessages(message)
            if kind == DATA and body[8:12] == SPDP_WRITER
        ]
    except (error, IndexError):
        raise Malformed("an announcement ends before it should")


def submessages(message):
    """Yield (kind, flags, body) of each submessage.

    Raises:
        Malformed: it is no RTPS message.
    """
    if len(message) < 20 or message[:4] != b"RTPS":
        raise Malformed("no RTPS message")
    at = 20
    while at + 4 <= len(message):
        kind, flags = message[at], message[at + 1]
        (size,) = unpack_from("<H" if flags & LITTLE else ">H", message, at + 2)
        end = at + 4 + size
        if size == 0 and kind not in (INFO_TS, 0x01):  # the last one, up to the message's end
            end = len(message)
        if end > len(message):
            raise Malformed("a submessage ends behind its message")
        yield kind, flags, message[at + 4 : end]
        at = end


def _participant(message, flags, body):
    order = "<" if flags & LITTLE else ">"
    found = {
        "prefix": message[8:20].hex(),
        "vendor": _vendor(message[6:8]),
        "domain": None,
        "name": "",
        "user_data": "",
        "locators": [],
        "lease": None,
        "leaving": bool(flags & WITH_KEY),
    }
    at = 4 + unpack_from(order + "H", body, 2)[0]
    if flags & INLINE:
        inline, at = parameter_list(body, at, order)
        found["leaving"] = any(v[3] & 3 for pid, v in inline if pid == PID_STATUS)
    if flags & (WITH_DATA | WITH_KEY):
        order = "<" if body[at + 1] & 1 else ">"
        for pid, value in parameter_list(body, at + 4, order)[0]:
            _take(found, pid, value, order)
    return found


def _vendor(raw):
    return VENDORS.get(raw[0] << 8 | raw[1], "vendor " + raw.hex())


def _take(found, pid, value, order):
    if pid == PID_GUID:
        found["prefix"] = value[:12].hex()
    elif pid == PID_DOMAIN:
        (found["domain"],) = unpack_from(order + "I", value)
    elif pid == PID_NAME:
        found["name"] = _text(value, order)
    elif pid == PID_USER_DATA:
        found["user_data"] = _text(value, order)
    elif pid == PID_LEASE:
        (found["lease"],) = unpack_from(order + "i", value)
    elif pid == PID_META_UNICAST:
        kind, port = unpack_from(order + "iI", value)
        if kind == UDP4:
            found["locators"].append((".".join(str(n) for n in value[20:24]), port))


def _text(value, order):
    (size,) = unpack_from(order + "I", value)
    return value[4 : 4 + size].rstrip(b"\0").decode("utf-8", "replace")


def parameter_list(body, at, order):
    """Return (pairs of id and value, where it ends)."""
    pairs = []
    while True:
        pid, size = unpack_from(order + "HH", body, at)
        at += 4
        if pid == PID_SENTINEL:
            return pairs, at
        if at + size > len(body):
            raise Malformed("a parameter ends behind its message")
        pairs.append((pid, body[at : at + size]))
        at += size


def header(prefix, vendor):
    """Return what every message of a participant begins with."""
    return b"RTPS" + VERSION + vendor + prefix


def _data(flags, content, number):
    """Return a DATA submessage from the announcer; `number` is its sequence number."""
    body = pack("<HH", 0, 16) + SPDP_READER + SPDP_WRITER + pack("<iI", 0, number) + content
    return pack("<BBH", DATA, flags, len(body)) + body


def serialized(pairs):
    """Return a parameter list as a sample's content."""
    return b"\x00\x03\x00\x00" + parameters(pairs)


def parameters(pairs):
    """Return pairs of id and value as a parameter list."""
    texts = [(pid, padded(value)) for pid, value in pairs]
    listed = b"".join(pack("<HH", pid, len(value)) + value for pid, value in texts)
    return listed + pack("<HH", PID_SENTINEL, 0)


def padded(value):
    """Return bytes filled up to a multiple of four."""
    return value + b"\0" * (-len(value) % 4)


def locator(address, port):
    """Return the place of a UDP socket as a parameter's value."""
    numbers = bytes(int(n) for n in address.split("."))
    return pack("<iI", UDP4, port) + b"\0" * 12 + numbers

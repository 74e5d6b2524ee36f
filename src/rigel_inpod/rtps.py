"""RTPS, the protocol below every DDS: headers, samples and parameter lists, read and written.

Why: whether ROS 2 nodes discover each other shows only in the packets, and images have no tool for
it. Contract: bytes in, bytes out; no socket, no clock. Written after OMG's DDSI-RTPS 2.5: 8.3
messages, 9.4 their encoding, 9.6.1 ports and addresses. The samples' contents are in spdp.py and
the exporter. Python 3.6 and newer, nothing but the standard library.
"""

from struct import pack, unpack_from

GROUP = "239.255.0.1"  # where participants announce themselves
SPDP_READER, SPDP_WRITER = b"\x00\x01\x00\xc7", b"\x00\x01\x00\xc2"
PARTICIPANT = b"\x00\x00\x01\xc1"
VERSION = b"\x02\x03"
UNKNOWN = b"\x00\x00"  # the vendor id of no vendor
FAST_DDS = b"\x01\x0f"  # its discovery server answers only its own kind
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

INFO_TS, INFO_DST, DATA = 0x09, 0x0E, 0x15
BEACON = 0xE5  # from 0x80 on a submessage is a vendor's own
LITTLE, INLINE, WITH_DATA, WITH_KEY = 0x01, 0x02, 0x04, 0x08

PID_KEY_HASH, PID_STATUS, PID_SENTINEL = 0x0070, 0x0071, 0x0001
PID_RELATED, PID_RELATED_FAST_DDS = 0x0083, 0x800F  # the identity of a sample

GONE = b"\x00\x00\x00\x03"  # disposed and unregistered; always big-endian


class Malformed(Exception):
    """These bytes are not an RTPS message, or a broken one."""


def announcement_port(domain):
    """Return the UDP port of a domain's multicast announcements."""
    return 7400 + 250 * domain


def participant_port(domain, index):
    """Return the UDP port at which a domain's participant number `index` receives announcements."""
    return 7410 + 250 * domain + 2 * index


def domain_of(port):
    """Return the domain that a port belongs to, None if it belongs to none."""
    domain = (port - 7400) // 250
    return domain if 0 <= domain <= 232 else None


def beacon(prefix):
    """Return a message that every participant must ignore (8.3.4.1)."""
    return header(prefix, UNKNOWN) + pack("<BBH", BEACON, LITTLE, 0)


def submessages(message):
    """Yield (kind, flags, body) of each submessage.

    Raises:
        Malformed: it is not an RTPS message.
    """
    if len(message) < 20 or message[:4] != b"RTPS":
        raise Malformed("not an RTPS message")
    at = 20
    while at + 4 <= len(message):
        kind, flags = message[at], message[at + 1]
        (size,) = unpack_from("<H" if flags & LITTLE else ">H", message, at + 2)
        end = at + 4 + size
        if size == 0 and kind not in (INFO_TS, 0x01):  # the last one, up to the message's end
            end = len(message)
        if end > len(message):
            raise Malformed("a submessage is longer than its message")
        yield kind, flags, message[at + 4 : end]
        at = end


def parameter_list(body, at, order):
    """Return (pairs of id and value, where it ends)."""
    pairs = []
    while True:
        pid, size = unpack_from(order + "HH", body, at)
        at += 4
        if pid == PID_SENTINEL:
            return pairs, at
        if at + size > len(body):
            raise Malformed("a parameter is longer than its message")
        pairs.append((pid, body[at : at + size]))
        at += size


def header(prefix, vendor):
    """Return the first bytes of every message of a participant."""
    return b"RTPS" + VERSION + vendor + prefix


def data(reader, writer, number, inline, payload, *, is_key=False):
    """Return a DATA submessage; `inline` is a parameter list or empty."""
    flags = LITTLE | (WITH_KEY if is_key else WITH_DATA) | (INLINE if inline else 0)
    body = pack("<HH", 0, 16) + reader + writer + sequence_number(number) + inline + payload
    return pack("<BBH", DATA, flags, len(body)) + body


def read_data(body, flags):
    """Return (writer, sequence number, payload, status, key hash) of a DATA submessage.

    payload: begins with its encapsulation, and is empty if the sample has none; status: 1 disposed,
    2 unregistered, 3 both; key hash: empty if the sample has none.
    """
    order = "<" if flags & LITTLE else ">"
    high, low = unpack_from(order + "iI", body, 12)
    at, status, key = 4 + unpack_from(order + "H", body, 2)[0], 0, b""
    if flags & INLINE:
        at, status, key = inline_qos(body, at, order)
    if flags & WITH_KEY and not status:
        status = 3  # only a key, and no reason given
    payload = body[at:] if flags & (WITH_DATA | WITH_KEY) else body[:0]
    return bytes(body[8:12]), (high << 32) + low, payload, status, key


def inline_qos(body, at, order):
    """Return (where a sample's inline QoS ends, its status, its key hash)."""
    status, key = 0, b""
    pairs, at = parameter_list(body, at, order)
    for pid, value in pairs:
        if pid == PID_STATUS:
            status = value[3] & 3
        elif pid == PID_KEY_HASH:
            key = bytes(value[:16])
    return at, status, key


def identity(prefix, writer, number):
    """Return the parameters of a sample's own identity; a server passes on only what has them."""
    sample = prefix + writer + sequence_number(number)
    return [(PID_RELATED, sample), (PID_RELATED_FAST_DDS, sample)]


def sequence_number(number):
    """Return a sample's number."""
    return pack("<iI", number >> 32, number & 0xFFFFFFFF)


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

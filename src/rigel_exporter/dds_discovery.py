"""Endpoints in discovery, read and written as parameter lists; SPDP has the participants.

Why: SPDP and SEDP (DDSI-RTPS 2.5: 8.5, 9.6.3) carry everything about a graph. Bytes in, plain data
out; it must not depend on sockets, time, or the use of what it reads.
"""

from __future__ import annotations

from struct import pack
from typing import NamedTuple, Union

from rigel_inpod import rtps
from rigel_inpod.spdp import PID_GUID, Parameters, text

PUBLICATIONS_WRITER, PUBLICATIONS_READER = b"\x00\x00\x03\xc2", b"\x00\x00\x03\xc7"
SUBSCRIPTIONS_WRITER, SUBSCRIPTIONS_READER = b"\x00\x00\x04\xc2", b"\x00\x00\x04\xc7"

#: We announce ourselves and our readers, and read all others; we have no writers.
ENDPOINTS = 0x01 | 0x02 | 0x08 | 0x10 | 0x20
HAS_PUBLICATIONS, HAS_SUBSCRIPTIONS = 0x04, 0x10

PID_TOPIC, PID_TYPE, PID_RELIABILITY, PID_DURABILITY = 0x0005, 0x0007, 0x001A, 0x001D
PID_OWNERSHIP, PID_PARTITION = 0x001F, 0x0029
PID_ENDPOINT, PID_REPRESENTATION = 0x005A, 0x0073
#: The property of participants to which a discovery server sends everything, and the protocol's
#: version.
SUPER_CLIENT = (("PARTICIPANT_TYPE", "SUPER_CLIENT"), ("DS_VERSION", "2.0"))
BEST_EFFORT, RELIABLE = 1, 2
VOLATILE, TRANSIENT_LOCAL = 0, 1

#: Bytes of a name, and of all partitions: DDS' names have 255 characters, and a length in front.
LONGEST = 512

Payload = Union[bytes, memoryview]


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


def endpoint(payload: Payload) -> Endpoint:
    """Read SEDP's data of a writer or reader.

    Raises:
        rtps.Malformed: it is not such data.
    """
    found = Parameters(payload)
    guid = found.raw(PID_ENDPOINT)
    if len(guid) != 16:
        raise rtps.Malformed("an endpoint without a GUID")
    if any(len(found.raw(pid)) > LONGEST for pid in (PID_TOPIC, PID_TYPE, PID_PARTITION)):
        raise rtps.Malformed("an endpoint with a name that DDS does not allow")
    # We write little-endian: a big-endian writer's would have to be converted.
    repeated = (PID_OWNERSHIP, PID_PARTITION) if found.order == "<" else ()
    return Endpoint(
        guid=guid,
        topic=found.text(PID_TOPIC),
        type=found.text(PID_TYPE),
        is_reliable=found.get(PID_RELIABILITY, "I", (BEST_EFFORT,))[0] == RELIABLE,
        is_local=found.get(PID_DURABILITY, "I", (VOLATILE,))[0] >= TRANSIENT_LOCAL,
        quality=tuple((pid, found.raw(pid)) for pid in repeated if found.raw(pid)),
    )


def key_of(payload: Payload) -> bytes:
    """Return the GUID in a payload that is only a key, empty if it has none."""
    found = Parameters(payload)
    return bytes(found.raw(PID_ENDPOINT) or found.raw(PID_GUID))


def reader_payload(own: Endpoint) -> bytes:
    """Write SEDP's data of a reader of ours; it accepts both encodings, XCDR 1 and 2."""
    reliability = RELIABLE if own.is_reliable else BEST_EFFORT
    durability = TRANSIENT_LOCAL if own.is_local else VOLATILE
    pairs = [
        (PID_ENDPOINT, own.guid),
        (PID_GUID, own.guid[:12] + rtps.PARTICIPANT),
        (PID_TOPIC, text(own.topic)),
        (PID_TYPE, text(own.type)),
        (PID_RELIABILITY, pack("<IiI", reliability, 0, 0)),
        (PID_DURABILITY, pack("<I", durability)),
        (PID_REPRESENTATION, pack("<Ihhh", 2, 0, 2, 0)),
        *own.quality,
    ]
    return bytes(rtps.serialized(pairs))

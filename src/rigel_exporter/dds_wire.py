"""The messages of reliable endpoints in RTPS, read without copying, and written.

Why: rigel_inpod/rtps.py has the headers and DATA, enough for announcements; reading endpoints
and counting samples also needs DATA_FRAG, HEARTBEAT, ACKNACK and GAP (DDSI-RTPS 2.5: 9.4.5). It
must not depend on sockets, time, or the meaning of the data.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from struct import error, pack, unpack_from
from typing import NamedTuple, Union

from rigel_inpod import rtps

ACKNACK, HEARTBEAT, GAP, INFO_SOURCE, DATA_FRAG = 0x06, 0x07, 0x08, 0x0C, 0x16
FINAL = 0x02
ANYBODY = b"\0" * 12
WIDEST = 256  # the most numbers that one ACKNACK or GAP names


class Data(NamedTuple):
    """A complete sample; `payload` begins with its encapsulation, or is empty.

    status: 1 disposed, 2 unregistered, 3 both; key: the key hash, may be empty.
    """

    writer: bytes
    number: int
    payload: memoryview
    status: int = 0
    key: bytes = b""


class Fragment(NamedTuple):
    """Some successive fragments of a sample; `first` counts from 1, the rest are bytes."""

    writer: bytes
    number: int
    first: int
    size: int
    total: int
    payload: memoryview


class Heartbeat(NamedTuple):
    """Which samples a writer has; last = first - 1 if it has none."""

    writer: bytes
    first: int
    last: int
    final: bool


class Acknack(NamedTuple):
    """What a reader has: everything before `base` except `missing`."""

    reader: bytes
    writer: bytes
    base: int
    missing: tuple[int, ...]


class Gap(NamedTuple):
    """Numbers a writer has no sample for: from `start` to before `base`, and `others`."""

    writer: bytes
    start: int
    base: int
    others: tuple[int, ...]


Item = Union[Data, Fragment, Heartbeat, Acknack, Gap]


def read(message: memoryview, own: bytes) -> Iterator[tuple[bytes, Item]]:
    """Yield (the sender's prefix, an item) for what is sent to `own` or to all.

    Raises:
        rtps.Malformed: these bytes are not a valid RTPS message.
    """
    source, is_for_us = bytes(message[8:20]), True
    for kind, flags, body in rtps.submessages(message):
        try:
            if kind == rtps.INFO_DST:
                is_for_us = bytes(body[:12]) in (own, ANYBODY)
            elif kind == INFO_SOURCE:
                source = bytes(body[8:20])
            elif is_for_us and kind in _READERS:
                yield source, _READERS[kind](body, flags, "<" if flags & rtps.LITTLE else ">")
        except (error, IndexError) as cause:
            raise rtps.Malformed("a submessage ends before it should") from cause


def _data(body: memoryview, flags: int, _: str) -> Data:
    return Data(*rtps.read_data(body, flags))


def _fragment(body: memoryview, flags: int, order: str) -> Fragment:
    first, _, size, total = unpack_from(order + "IHHI", body, 20)
    at = 4 + _offset(body, order)
    if flags & rtps.INLINE:
        at = rtps.inline_qos(body, at, order)[0]
    if not first or not size:
        raise rtps.Malformed("a fragment without a number or a size")
    return Fragment(bytes(body[8:12]), _number(body, 12, order), first, size, total, body[at:])


def _heartbeat(body: memoryview, flags: int, order: str) -> Heartbeat:
    first, last = _number(body, 8, order), _number(body, 16, order)
    return Heartbeat(bytes(body[4:8]), first, last, bool(flags & FINAL))


def _acknack(body: memoryview, _: int, order: str) -> Acknack:
    base, missing = _numbers(body, 8, order)
    return Acknack(bytes(body[0:4]), bytes(body[4:8]), base, missing)


def _gap(body: memoryview, _: int, order: str) -> Gap:
    base, others = _numbers(body, 16, order)
    return Gap(bytes(body[4:8]), _number(body, 8, order), base, others)


_READERS: dict[int, Callable[[memoryview, int, str], Item]] = {
    rtps.DATA: _data,
    DATA_FRAG: _fragment,
    HEARTBEAT: _heartbeat,
    ACKNACK: _acknack,
    GAP: _gap,
}


def _offset(body: memoryview, order: str) -> int:
    return int(unpack_from(order + "H", body, 2)[0])


def _number(body: memoryview, at: int, order: str) -> int:
    high, low = unpack_from(order + "iI", body, at)
    return int((high << 32) + low)


def _numbers(body: memoryview, at: int, order: str) -> tuple[int, tuple[int, ...]]:
    """Return (base, the numbers whose bit is set)."""
    base = _number(body, at, order)
    (width,) = unpack_from(order + "I", body, at + 8)
    if width > WIDEST:
        raise rtps.Malformed("a set of more than 256 numbers")
    words = unpack_from(f"{order}{(width + 31) // 32}I", body, at + 12)
    return base, tuple(base + i for i in range(width) if words[i >> 5] >> (31 - i % 32) & 1)


def message(prefix: bytes, vendor: bytes, to: bytes, submessages: Iterable[bytes]) -> bytes:
    """Return a message to the participant `to`, or to all if that is empty."""
    aim = pack("<BBH", rtps.INFO_DST, rtps.LITTLE, 12) + to if to else b""
    return bytes(rtps.header(prefix, vendor)) + aim + b"".join(submessages)


def heartbeat(
    reader: bytes, writer: bytes, first: int, last: int, count: int, *, final: bool
) -> bytes:
    """Return a HEARTBEAT, which a reader must answer unless it is final."""
    body = reader + writer + _pack(first) + _pack(last) + pack("<I", count)
    return pack("<BBH", HEARTBEAT, rtps.LITTLE | (FINAL if final else 0), len(body)) + body


def acknack(
    reader: bytes, writer: bytes, base: int, missing: Iterable[int], count: int, *, final: bool
) -> bytes:
    """Return an ACKNACK: all before `base` has arrived, `missing` (from `base` on) is requested."""
    body = reader + writer + _pack(base) + _bits(base, missing) + pack("<I", count)
    return pack("<BBH", ACKNACK, rtps.LITTLE | (FINAL if final else 0), len(body)) + body


def gap(reader: bytes, writer: bytes, start: int, end: int) -> bytes:
    """Return a GAP: no samples exist from `start` to before `end`."""
    body = reader + writer + _pack(start) + _pack(end) + pack("<I", 0)
    return pack("<BBH", GAP, rtps.LITTLE, len(body)) + body


def _pack(number: int) -> bytes:
    return bytes(rtps.sequence_number(number))


def _bits(base: int, numbers: Iterable[int]) -> bytes:
    offsets = [number - base for number in numbers if 0 <= number - base < WIDEST]
    width = max(offsets) + 1 if offsets else 0
    words = [0] * ((width + 31) // 32)
    for offset in offsets:
        words[offset >> 5] |= 1 << (31 - offset % 32)
    return pack(f"<I{len(words)}I", width, *words)

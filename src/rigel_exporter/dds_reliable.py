"""What remote writers have sent, reliably or best effort, and what a writer of ours keeps.

Why: SEDP and ros_discovery_info are reliable: a reader that does not acknowledge is sent everything
again, and one that does not request missing samples does not get them (DDSI-RTPS 2.5: 8.4.9,
8.4.12). It must not depend on sockets, time, or the meaning of samples.
"""

from __future__ import annotations

from typing import NamedTuple

from rigel_exporter import dds_wire as wire
from rigel_exporter import messages
from rigel_exporter.samples import Subscription
from rigel_inpod import rtps

_AHEAD = 1024  # samples that are kept until the ones before them arrive
_BROKEN = 8  # samples of a writer that are put together from fragments at a time
_LARGEST = 4 << 20  # bytes of a sample that is put together
_SMALLEST = 256  # bytes of a fragment


class Change(NamedTuple):
    """One sample; status and key as in wire.Data."""

    payload: bytes
    status: int = 0
    key: bytes = b""


class Assembly:
    """A sample whose fragments arrive in any order."""

    def __init__(self, first: wire.Fragment) -> None:
        self.size = first.size
        self.whole = bytearray(first.total)
        self.left = set(range(-(-len(self.whole) // self.size)))

    @staticmethod
    def fits(part: wire.Fragment) -> bool:
        """Whether a fragment's size is plausible; no DDS makes smaller or larger samples."""
        return part.total <= _LARGEST and part.size >= _SMALLEST

    def add(self, part: wire.Fragment) -> bytes | None:
        """Return the sample when it is complete."""
        index, at = part.first - 1, 0
        while at < len(part.payload) and index in self.left:
            begin = index * self.size
            piece = part.payload[at : at + min(self.size, len(self.whole) - begin)]
            self.whole[begin : begin + len(piece)] = piece
            self.left.discard(index)
            index, at = index + 1, at + self.size
        return None if self.left else bytes(self.whole)


class Incoming:
    """A remote writer as a reader of ours sees it: its samples in order, each once."""

    def __init__(self, reader: bytes, *, holds_back: bool = False) -> None:
        """`holds_back`: never acknowledge the latest sample, so its writer keeps asking."""
        self.reader, self._holds_back = reader, holds_back
        self.done = 0  # all up to this number are handed out, or do not exist
        self.last = 0
        self.is_known = False  # a heartbeat has announced the writer's samples
        self._count = 0
        self._waiting: dict[int, Change | None] = {}
        self._broken: dict[int, Assembly] = {}

    def take(self, item: wire.Data | wire.Fragment) -> list[Change]:
        """Return what can be handed out now."""
        if item.number <= self.done or item.number in self._waiting:
            return []
        if isinstance(item, wire.Data):
            self._keep(item.number, Change(bytes(item.payload), item.status, item.key))
        else:
            self._assemble(item)
        return self._take_ready()

    def heartbeat(self, item: wire.Heartbeat) -> list[Change]:
        """Take in which samples the writer has; earlier ones are not waited for."""
        if item.first < 1 or item.last < item.first - 1:
            return []
        if item.last < self.done:
            self._start_over()
        self.is_known = True
        self.done = max(self.done, item.first - 1)
        self.last = max(item.last, self.done)
        self._waiting = {n: change for n, change in self._waiting.items() if n > self.done}
        return self._take_ready()

    def _start_over(self) -> None:
        """Follow a writer that has restarted, as a discovery server does with its old GUID.

        If the heartbeat was only late, samples arrive twice, which does no harm here.
        """
        self.done, self.last = 0, 0
        self._waiting.clear()
        self._broken.clear()

    def gap(self, item: wire.Gap) -> list[Change]:
        """Take in which samples the writer does not have."""
        if item.start <= self.done + 1:
            self.done = max(self.done, item.base - 1)
        elif item.base - item.start <= _AHEAD:
            for number in range(item.start, item.base):
                self._keep(number, None)
        for number in item.others:
            self._keep(number, None)
        self._waiting = {n: change for n, change in self._waiting.items() if n > self.done}
        return self._take_ready()

    def list_missing(self) -> list[int]:
        """Return the numbers that are still missing."""
        end = min(self.last + 1, self.done + 1 + wire.WIDEST)
        return [number for number in range(self.done + 1, end) if number not in self._waiting]

    def answer(self, writer: bytes, *, final: bool = True) -> bytes:
        """Return the ACKNACK of what has arrived; if not final, the writer sends a heartbeat."""
        self._count += 1
        missing = self.list_missing()
        base = self.done + 1 if self.is_known else 0
        if self._holds_back and not missing:
            base = self.done
        return wire.acknack(self.reader, writer, base, missing, self._count, final=final)

    def _keep(self, number: int, change: Change | None) -> None:
        if self.done < number <= self.done + _AHEAD or not self.is_known:
            if len(self._waiting) < _AHEAD:
                self._waiting[number] = change
            self._broken.pop(number, None)

    def _assemble(self, part: wire.Fragment) -> None:
        if not Assembly.fits(part):
            self._keep(part.number, None)
            return
        if part.number not in self._broken and len(self._broken) >= _BROKEN:
            del self._broken[min(self._broken)]
        whole = self._broken.setdefault(part.number, Assembly(part)).add(part)
        if whole is not None:
            self._keep(part.number, Change(whole))

    def _take_ready(self) -> list[Change]:
        found = []
        while self.is_known and self.done + 1 in self._waiting:
            self.done += 1
            change = self._waiting.pop(self.done)
            if change:
                found.append(change)
        self.last = max(self.last, self.done)
        return found


class Outgoing:
    """A reliable writer of ours that keeps all samples except dropped ones."""

    def __init__(self, writer: bytes, reader: bytes) -> None:
        self.writer, self.reader, self.last = writer, reader, 0
        self._kept: dict[int, bytes] = {}
        self._count = 0

    def add(self, inline: bytes, payload: bytes, *, is_key: bool = False) -> int:
        """Keep a sample; return its number."""
        self.last += 1
        self._kept[self.last] = rtps.data(
            self.reader, self.writer, self.last, inline, payload, is_key=is_key
        )
        return self.last

    def drop(self, number: int) -> None:
        """Forget a sample that a later one replaces."""
        self._kept.pop(number, None)

    def beat(self, *, final: bool = False) -> bytes:
        """Return a heartbeat; its receiver must answer, unless it is final."""
        self._count += 1
        first = min(self._kept) if self._kept else self.last + 1
        return wire.heartbeat(self.reader, self.writer, first, self.last, self._count, final=final)

    def sample(self, number: int) -> bytes:
        """Return a sample, or a GAP if it does not exist."""
        kept = self._kept.get(number)
        return kept or wire.gap(self.reader, self.writer, number, number + 1)

    def is_behind(self, item: wire.Acknack) -> bool:
        """Whether a reader does not have all samples."""
        return item.base <= self.last

    def answer(self, item: wire.Acknack) -> list[bytes]:
        """Return the samples that a reader requests."""
        return [self.sample(n) for n in item.missing if n <= self.last]


class Source:
    """A remote writer of a named topic as a best-effort reader of ours sees it.

    A sample counts with the first of its fragments, which contains its size, so a lost fragment
    only loses that sample's payload.
    """

    def __init__(self, subscription: Subscription, type_name: str) -> None:
        self.subscription, self.type = subscription, type_name
        self._last = 0
        self._whole: Assembly | None = None

    def take(self, item: wire.Data | wire.Fragment, now: float) -> None:
        """Take in a sample or fragments of one; `now` is in seconds since 1970."""
        if isinstance(item, wire.Data):
            if item.number > self._last and len(item.payload):
                self._last = item.number
                self.subscription.count(len(item.payload), self._stamp(item.payload), now)
                self.subscription.keep(item.payload)
        elif item.number >= self._last:
            self._take_part(item, now)

    def _take_part(self, part: wire.Fragment, now: float) -> None:
        if part.number > self._last:
            self._last, self._whole = part.number, None
            self.subscription.count(part.total, None, now)
            if self.subscription.keeps and Assembly.fits(part):
                self._whole = Assembly(part)
        if part.first == 1:
            self.subscription.stamp(self._stamp(part.payload))
        whole = self._whole.add(part) if self._whole else None
        if whole is not None:
            self._whole = None
            self.subscription.keep(whole)

    def _stamp(self, payload: memoryview) -> float | None:
        try:
            return messages.stamp(payload, self.type)
        except messages.Unreadable:
            return None

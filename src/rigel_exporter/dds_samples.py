"""One writer of a named topic in DDS: its samples are counted as they arrive.

A sample counts with the first of its fragments, which contains its size, so a lost fragment only
loses that sample's payload. It must not depend on sockets, or on how readers are announced.
"""

from __future__ import annotations

from rigel_exporter import dds_wire as wire
from rigel_exporter import messages
from rigel_exporter.dds_reliable import Assembly
from rigel_exporter.samples import Subscription


class Source:
    """One writer, and what was received from it."""

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

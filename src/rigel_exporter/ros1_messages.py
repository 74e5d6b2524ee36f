"""Reads the few ROS 1 messages that the exporter needs, without ROS.

Every function raises ValueError if the bytes are not such a message.
"""

from __future__ import annotations

import struct

#: The bytes of a Header up to the end of its stamp.
HEADER = 12


class _Reader:
    """A message, read field by field."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    def number(self) -> int:
        """Return a uint32."""
        return int.from_bytes(self.raw(4), "little")

    def raw(self, size: int) -> bytes:
        """Return so many bytes."""
        end = self._at + size
        if end > len(self._data):
            raise ValueError(f"the message ends at byte {len(self._data)}, not at {end}")
        found, self._at = self._data[self._at : end], end
        return found

    def text(self) -> str:
        """Return a string."""
        return self.raw(self.number()).decode("utf-8", "replace")

    def time(self) -> float:
        """Return a time in seconds."""
        return self.number() + self.number() / 1e9

    def header(self) -> float:
        """Return a Header's stamp in seconds."""
        self.number()
        found = self.time()
        self.text()
        return found


def has_header(definition: str) -> bool:
    """Return whether a message definition's first field is a Header."""
    for line in definition.splitlines():
        words = line.partition("#")[0].split()
        if words and "=" not in line.partition("#")[0]:
            return words[0] in ("Header", "std_msgs/Header")
        if line.startswith("===="):
            return False
    return False


def stamp(data: bytes) -> float | None:
    """Return the stamp, in seconds, of the Header that a message begins with; None for none."""
    if len(data) < HEADER:
        return None
    _, seconds, nanoseconds = struct.unpack_from("<III", data)
    return float(seconds + nanoseconds / 1e9) or None


def clock(payload: bytes) -> float:
    """Return the time of a rosgraph_msgs/Clock in seconds."""
    return _Reader(payload).time()


def diagnostics(payload: bytes) -> list[tuple[str, str, int]]:
    """Return (name, hardware id, level) of each status in a diagnostic_msgs/DiagnosticArray."""
    reader = _Reader(payload)
    reader.header()
    return [_status(reader) for _ in range(reader.number())]


def _status(reader: _Reader) -> tuple[str, str, int]:
    level = reader.raw(1)[0]
    name, _, hardware = reader.text(), reader.text(), reader.text()
    for _ in range(2 * reader.number()):
        reader.text()
    return name, hardware, level


def transforms(payload: bytes) -> list[tuple[str, str, float]]:
    """Return (parent, child, stamp in seconds) of each transform in a tf2_msgs/TFMessage."""
    reader = _Reader(payload)
    return [_transform(reader) for _ in range(reader.number())]


def _transform(reader: _Reader) -> tuple[str, str, float]:
    reader.number()
    when = reader.time()
    parent, child = reader.text(), reader.text()
    reader.raw(7 * 8)
    return parent, child, when

"""The state as events, where it outlives the gate: a file of the pod, an object of the cluster."""

from __future__ import annotations

import base64
import json
import os
import zlib
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import Iterable, Iterator

from rigel_gate.state import REVISION, Event, State, check, line_of

#: Events after a state in the file after which it is rewritten, and bytes: as many as the state
#: has, and these. So the file has at most twice the state, and this.
LINES, ROOM = 20000, 4 * 2**20
#: Bytes of events that may come while a state is written.
LARGEST_TAIL = 32 * 2**20
#: Blocks of a disk that have to be left by a file that takes another one's place.
SPARE = 8
#: Bytes of a line: more than that of any event, which is a call of the largest size.
LONGEST = 2**27
#: Bytes of a text from the cluster that are decompressed at once, and of events that are written
#: at once.
PIECE = 2**20


class TooLarge(ValueError):
    """A state has more bytes than its place takes."""


class Journal:
    """The events in a file, each written before its cause is answered.

    The file survives the program but not the machine, so nothing waits for a disk. From time to
    time a state is written beside it, in a thread perhaps, and takes its place: `draft` what is to
    be written, `write` it, `catch_up`, `finish`; `abandon` it after an error. Events that come
    meanwhile are written to both.

    Args:
        path: in a directory that lives as long as the pod.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._beside = path.with_suffix(".new")
        self._file: FileIO | None = None
        self._fresh: FileIO | None = None
        self._tail: bytearray | None = None  # the events since the draft
        self._tail_lines = 0
        self._lines, self._size, self._base = 0, 0, 0

    @property
    def is_open(self) -> bool:
        """Whether the file has every event."""
        return self._file is not None

    @property
    def is_due(self) -> bool:
        """Whether the file should be rewritten: it is too large, or an event is missing."""
        is_large = self._lines >= LINES or self._size > 2 * self._base + ROOM
        return is_large or self._file is None

    def read(self) -> State | None:
        """Return the state that was kept, None if none was; one line of it is in memory at a time.

        Raises:
            OSError, ValueError: nothing in it can be read.
        """
        with suppress(OSError):  # a gate that was killed may have left it
            self._beside.unlink()
        if not self._path.exists():
            return None
        if not self._path.is_file():
            raise ValueError(f"{self._path} is not a file")
        with self._path.open("rb") as file:
            state = replay(iter(lambda: file.readline(LONGEST), b""))
        if state.left_out and not state.revision:
            raise ValueError("no line of it is an event")
        return state

    def resume(self) -> None:
        """Add later events to a file that has been read; raises OSError."""
        close(self._file)
        self._file = self._path.open("ab", buffering=0)
        self._size = self._file.tell()

    def keep(self, event: Event) -> None:
        """Write an event, which the state has already applied; raises OSError."""
        line = line_of(event)
        if self._tail is not None:
            self._tail += line
            self._tail_lines += 1
            if len(self._tail) > LARGEST_TAIL:
                self._tail = None
        if self._file is None:
            return  # a state will be written that has the event
        try:
            write_all(self._file, line)
        except OSError:
            close(self._file)
            self._file = None
            raise
        self._size += len(line)
        self._lines += 1

    def begin(self, state: State) -> None:
        """Write a state; later events are added to it. Raises OSError."""
        try:
            self.write(self.draft(state))
            self.finish()
        except OSError:
            self.abandon()
            raise

    def draft(self, state: State) -> Iterable[Event]:
        """Return what `write` takes: the state as it is now."""
        self._tail, self._tail_lines = bytearray(), 0
        return state.events()

    def write(self, events: Iterable[Event]) -> None:
        """Write a state beside the file, which stays as it is. Raises OSError."""
        try:
            self._write(events)
        except OSError:
            self._remove_fresh()
            if self._file is not None or not self._fits_alone(events):
                raise
            self._path.unlink()  # it is missing events anyway
            self._write(events)

    @property
    def is_behind(self) -> bool:
        """Whether `write` has missed so many events that others would notice `finish`."""
        return len(self._tail or b"") > PIECE

    def take_tail(self) -> bytearray:
        """Return what `catch_up` takes: the events that `write` has missed."""
        tail, self._tail = self._tail or bytearray(), bytearray()
        return tail

    def catch_up(self, tail: bytearray) -> None:
        """Write events behind what `write` has written; raises OSError."""
        if self._fresh is not None:
            write_all(self._fresh, tail)

    def finish(self) -> None:
        """Let what `write` has written take the file's place; raises OSError."""
        fresh, tail = self._fresh, self._tail
        if fresh is None or tail is None:
            raise OSError("more events come than can be written")
        write_all(fresh, tail)
        self._beside.replace(self._path)
        close(self._file)
        self._file, self._fresh, self._tail = fresh, None, None
        self._size, self._lines = fresh.tell(), self._tail_lines

    def abandon(self) -> None:
        """Remove what has been written beside the file, after an error."""
        self._tail = None
        self._remove_fresh()

    def _remove_fresh(self) -> None:
        close(self._fresh)
        self._fresh = None
        with suppress(OSError):
            self._beside.unlink()

    def _write(self, events: Iterable[Event]) -> None:
        self._fresh = self._beside.open("wb", buffering=0)
        for event in events:
            write_all(self._fresh, line_of(event))
        self._base = self._fresh.tell()

    def _fits_alone(self, events: Iterable[Event]) -> bool:
        """Return whether a state has room on the disk in the place of the file."""
        if not self._path.is_file():
            return False
        disk = os.statvfs(self._path)
        room = disk.f_bavail + self._path.stat().st_size // disk.f_frsize
        return sum(len(line_of(event)) for event in events) // disk.f_frsize + SPARE <= room


def write_all(file: FileIO, data: bytes | bytearray) -> None:
    """Write all bytes; raises OSError."""
    done = file.write(data)
    while done < len(data):
        done += file.write(memoryview(data)[done:])


def close(file: FileIO | None) -> None:
    """Close a file, if there is one; what could not be written before cannot be now."""
    if file is not None:
        with suppress(OSError):
            file.close()


def replay(lines: Iterable[str | bytes]) -> State:
    """Return the state that lines give, without those that are damaged or from another version."""
    state = State()
    for line in lines:
        try:
            event = json.loads(line)
            check(event)
            state.apply(event)
        except Exception:  # json's, expat's, too deep: whatever it is, it concerns this line alone
            state.left_out += 1
    return state


def compress(events: Iterable[Event], largest: int) -> str:
    """Return a state as text for an object of the cluster; may run in a thread.

    Raises:
        TooLarge: it has more than this number of characters; this is found out as soon as possible.
    """
    packer = zlib.compressobj(6)
    found = bytearray()
    for event in events:
        found += packer.compress(line_of(event))
        if len(found) > largest * 3 // 4:
            break
    found += packer.flush()
    if len(found) > largest * 3 // 4:
        raise TooLarge(f"it has more than {largest} bytes, compressed")
    return base64.b64encode(found).decode("ascii")


def decompress(text: str) -> State:
    """Return the state of a text of `compress`; raises ValueError for another one."""
    return replay(_decompress(text))


def read_revision(text: str) -> int:
    """Return the revision of a text of `compress`, 0 without one; raises ValueError."""
    for line in _decompress(text):
        with suppress(ValueError, LookupError, TypeError):
            name, revision = json.loads(line)
            return int(revision) if name == REVISION else 0
        break
    return 0


def _decompress(text: str) -> Iterator[bytes]:
    """Yield the lines of a text, which can be much larger than the text; raises ValueError."""
    unpacker, rest = zlib.decompressobj(), b""
    try:
        data = base64.b64decode(text, validate=True)
        while not unpacker.eof:
            piece = unpacker.decompress(data, PIECE)
            data = unpacker.unconsumed_tail
            if not piece and not unpacker.eof:
                raise ValueError("it is cut off")
            *lines, rest = (rest + piece).split(b"\n")
            yield from lines
    except (ValueError, zlib.error) as error:
        raise ValueError(f"this gate did not write it: {error}") from error
    if rest:
        yield rest

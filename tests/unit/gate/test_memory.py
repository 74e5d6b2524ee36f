"""What outlives a gate: a file of its pod, a text for the cluster."""

from __future__ import annotations

import asyncio
import base64
import errno
import json
import os
import random
import threading
import tracemalloc
import zlib
from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress
from functools import partial, wraps
from io import FileIO
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rigel_gate import __main__ as program
from rigel_gate import keeper as keepers
from rigel_gate import memory
from rigel_gate.cluster import NotKept, Overtaken
from rigel_gate.keeper import LARGEST, LONGEST_PAUSE, PAUSE, TRIES, Keeper
from rigel_gate.memory import (
    ROOM,
    Journal,
    TooLarge,
    compress,
    decompress,
    read_revision,
    replay,
)
from rigel_gate.state import PIECE, Event, State, line_of, pack

#: A parameter with more levels than Python's own writer of XML-RPC has.
DEEP = 500 * "/a"
EVENTS: list[Event] = [
    ["run", "run 1"],
    ["set", "/robot", pack({"name": "rosie ä", "size": 1.5})],
    ["set", "/gone", pack(1)],
    ["delete", "/gone"],
    ["register", "publisher", "/t", "/n", "http://h:1/", "t/T", True],
    ["register", "service", "/s", "/n", "http://h:1/", "rosrpc://h:2", False],
    ["register", "publisher", "/t", "/m", "http://i:1/", "t/T", False],
    ["unregister", "publisher", "/t", "/m", "http://i:1/"],
    ["register", "publisher", "/t", "/lost", "http://j:1/", "t/T", False],
    ["silent", "/lost"],
    ["wait", "publisher", "/t", "/n", "http://k:1/", "t/T"],
    ["wait", "publisher", "/u", "/n", "http://k:1/", "t/T"],
    ["unwait", "publisher", "/u", "/n", "http://k:1/"],
    ["wait", "publisher", "/t", "/n", "http://l:1/", "t/T"],
    ["dismiss", "/n", "http://l:1/"],
    ["pod", "h", "pod-1", "app"],
    ["pod", "k", "pod-2", "app"],
    ["leave", "h"],
    ["pod", "x", "pod-3", "app"],
    ["away", "x"],
]


def run(test: Callable[..., Coroutine[Any, Any, None]]) -> Callable[..., None]:
    """Run a test that is a coroutine."""

    @wraps(test)
    def made(*arguments: Any, **options: Any) -> None:
        asyncio.run(test(*arguments, **options))

    return made


def known(state: State) -> dict[str, Any]:
    """Return all that a state holds."""
    return {
        "nodes": {
            name: (entry.api, entry.hands_over, sorted(entry.registrations.values()))
            for name, entry in state.registry.nodes.items()
        },
        "parameters": state.parameters.tree,
        "newcomers": {key: sorted(one.all()) for key, one in state.newcomers.items()},
        "pods": state.pods,
        "leaving": state.leaving,
        "silent": state.silent,
        "run": state.run,
    }


def packed(state: State) -> str:
    """Return what the cluster keeps of a state."""
    return compress(state.events(), LARGEST)


def kept(path: Path) -> dict[str, Any]:
    """Return all that another journal reads from a file."""
    found = Journal(path).read()
    assert found is not None
    return known(found)


@pytest.fixture
def state() -> State:
    found = State()
    for event in EVENTS:
        found.apply(event)
    return found


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    found = Journal(tmp_path / "journal")
    yield found
    memory.close(found._file)


def test_a_state_is_what_its_events_make(state: State):
    assert set(state.registry.nodes) == {"/n", "/lost"}
    assert list(state.newcomers) == [("/n", "http://k:1/")]
    assert (state.leaving, state.silent) == ({"h"}, {"/lost"})
    assert set(state.pods) == {"h", "k"}
    assert state.parameters.tree == {"robot": {"name": "rosie ä", "size": 1.5}}


def test_a_states_own_events_make_it_again(state: State):
    """In lines, as the file has them, and as text for the cluster."""
    assert known(replay(map(line_of, state.events()))) == known(state)
    assert known(decompress(packed(state))) == known(state)
    assert packed(state).isascii()


def test_the_journal_has_each_event_at_once(journal: Journal, tmp_path: Path):
    """A gate that is killed has written what it has answered."""
    assert journal.read() is None
    found = State()
    journal.begin(found)
    for event in EVENTS:
        found.apply(event)
        journal.keep(event)
        assert kept(tmp_path / "journal") == known(found)


@pytest.mark.parametrize(
    "stale",
    [
        '["register", "publisher", "/t", "/cut o',
        '["an event of a later gate", 1]\n',
        '["register", "too few"]\n',
        "7\n",
        "[]\n",
        "{}\n",
        "\n",
        '["set", "/", "<broken"]\n',
        '["set", "/x", 7]\n',
        f'["set", "{DEEP}", {json.dumps(pack(1))}]\n',
        '["silent", null]\n',
        '["run", 7]\n',
        '["register", "nothing", "/t", "/n", "http://h:1/", "t/T", true]\n',
        '["register", "publisher", "/t", "/n", "http://h:1/", "t/T", "yes"]\n',
        100_000 * "[" + "\n",
        "\udcff\n",
    ],
)
def test_a_stale_line_costs_that_line_only(
    journal: Journal, tmp_path: Path, state: State, stale: str
):
    """One that was cut off, or that another version has written: the gate starts all the same."""
    lines = [line_of(event) for event in state.events()]
    lines.insert(3 if stale.endswith("\n") else len(lines), os.fsencode(stale))
    (tmp_path / "journal").write_bytes(b"".join(lines))
    found = journal.read()
    assert found is not None
    assert known(found) == known(state)
    assert found.left_out == 1
    assert packed(found), "what has been read can be written again"


@pytest.mark.parametrize("damage", ["folder", "pipe", "noise"])
@run
async def test_a_journal_that_cannot_be_read_leaves_the_clusters_copy(
    journal: Journal,
    tmp_path: Path,
    place: Place,
    state: State,
    damage: str,
    capsys: pytest.CaptureFixture[str],
):
    """The gate starts all the same, and says so in one line."""
    path = tmp_path / "journal"
    {"folder": path.mkdir, "pipe": lambda: os.mkfifo(path)}.get(
        damage, lambda: path.write_bytes(b"\xff\n{}\n")
    )()
    place.kept = packed(state)

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if "is not used" in line] == lines[:1]


@run
async def test_a_damaged_copy_in_the_cluster_costs_its_bad_lines_only(
    journal: Journal, place: Place, state: State, capsys: pytest.CaptureFixture[str]
):
    lines = [*map(line_of, state.events()), b"\xff\n", b'["silent", null]\n']
    place.kept = base64.b64encode(zlib.compress(b"".join(lines))).decode()

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)
    said = capsys.readouterr().out
    assert said == "gate: 2 lines of the memory cannot be read: they are left out\n"


@run
async def test_a_fault_while_saving_does_not_end_saving(
    journal: Journal, place: Place, capsys: pytest.CaptureFixture[str]
):
    """Nothing would be kept in the cluster any more, without a word."""
    pauses = Pauses()
    keeper = await begin(journal, place, pauses)
    place.fails.append(RuntimeError("bug"))
    running = asyncio.ensure_future(keeper.run())
    keep(keeper, EVENTS[0])
    await pauses.until(1)
    pauses.end()
    await pauses.until(2)
    running.cancel()
    assert place.writes == 2
    assert place.kept is not None
    assert keeper.list_troubles() == []
    assert "the memory is not kept in the cluster: RuntimeError('bug')" in capsys.readouterr().out


@run
async def test_the_file_has_at_most_twice_the_state_and_some_room(
    tmp_path: Path, place: Place, state: State
):
    """A parameter of 12 KB that is set ten times a second was 181 MB after 25 minutes."""
    keeper = await begin(Journal(tmp_path / "journal"), place)
    running = asyncio.ensure_future(keeper.run())
    for event in EVENTS:
        keep(keeper, event)
    base = len(b"".join(map(line_of, keeper.state.events())))
    sizes = []
    for number in range(1000):
        keep(keeper, ["set", "/map", pack(f"{number:012000}")])
        sizes.append((tmp_path / "journal").stat().st_size)
        while keeper._journal.is_due or keeper._journal._tail is not None:  # being written anew
            await asyncio.sleep(0.001)
    running.cancel()
    assert ROOM < max(sizes) < ROOM + 2 * (base + 13_000)
    assert sizes != sorted(sizes), "it has been rewritten"
    assert kept(tmp_path / "journal") == known(keeper.state)
    memory.close(keeper._journal._file)


def test_many_small_events_are_rewritten_too(journal: Journal, monkeypatch: pytest.MonkeyPatch):
    """A gate that starts must not take long to read them."""
    monkeypatch.setattr(memory, "LINES", 10)
    journal.begin(State())
    for number in range(10):
        assert not journal.is_due
        journal.keep(["set", "/n", pack(number)])
    assert journal.is_due


def test_what_comes_while_the_file_is_written_is_in_it(journal: Journal, tmp_path: Path):
    """And if the gate is killed before the new file is complete, the old one has it."""
    found = State()
    journal.begin(found)
    for number, event in enumerate(EVENTS):
        events = journal.draft(found) if number % 3 == 0 else None
        found.apply(event)
        journal.keep(event)
        if events is not None:
            journal.write(events)
            assert kept_without_reading_on(tmp_path) == known(found)
            journal.finish()
        assert kept_without_reading_on(tmp_path) == known(found)
    again = Journal(tmp_path / "journal").read()
    assert again is not None
    assert again.revision == found.revision == len(EVENTS)


def kept_without_reading_on(folder: Path) -> dict[str, Any]:
    """Return what the file has, without the new one that another journal would remove."""
    (folder / "copy").write_bytes((folder / "journal").read_bytes())
    return kept(folder / "copy")


def test_more_events_than_can_be_written_leave_the_file_as_it_is(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(memory, "LARGEST_TAIL", 100)
    found = State()
    journal.begin(found)
    journal.write(journal.draft(found))
    for event in EVENTS:
        found.apply(event)
        journal.keep(event)
    with pytest.raises(OSError, match="more events come than can be written"):
        journal.finish()
    journal.abandon()
    assert [path.name for path in tmp_path.iterdir()] == ["journal"]
    assert journal.is_open
    assert kept(tmp_path / "journal") == known(found)


def test_a_large_state_is_read_and_written_in_pieces(journal: Journal, tmp_path: Path):
    """Of a file of any size only a line is in memory; many small values are in few lines."""
    found = State()
    for number in range(30):
        found.apply(["set", f"/deep/{number % 3}/{number}", pack(100_000 * str(number))])
    found.apply(["set", "/deep/odd", pack({"a/b": 600_000 * "x", "": 1, "empty": {}})])
    found.apply(["set", "/many", pack({f"m{number}": number for number in range(5000)})])
    found.apply(["set", "/many/of/them", pack(2000 * "x")])
    journal.begin(found)
    lines = (tmp_path / "journal").read_bytes().splitlines()
    assert max(map(len, lines)) < 700_000
    assert len(lines) < 50
    assert kept(tmp_path / "journal") == known(found)
    assert known(decompress(packed(found))) == known(found)
    tracemalloc.start()
    journal.read()
    least, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    size = (tmp_path / "journal").stat().st_size
    assert most < 2 * size < 2 * most + 2 * least, "the state, and a part of it"


def test_a_copy_of_a_state_does_not_change_with_it(state: State):
    """A thread writes it while calls are answered."""
    before, events = known(state), state.events()
    first = next(iter(events))
    state.apply(["set", "/robot/more", pack(1)])
    state.apply(["forget", "/n"])
    assert next(iter(events)) == first
    assert known(replay(map(line_of, events))) == {**before, "parameters": PARAMETERS}


PARAMETERS = {"robot": {"name": "rosie ä", "size": 1.5}}


def make_full(journal: Journal) -> None:
    """Let a journal write to a disk that is full."""
    memory.close(journal._file)
    journal._file = Path("/dev/full").open("ab", buffering=0)  # noqa: SIM115 - the journal closes it


def test_a_disk_that_is_full_loses_nothing_when_it_has_room_again(journal: Journal, tmp_path: Path):
    found = State()
    journal.begin(found)
    make_full(journal)
    found.apply(EVENTS[0])
    with pytest.raises(OSError, match="No space left"):
        journal.keep(EVENTS[0])
    assert journal.is_due
    found.apply(EVENTS[1])
    journal.keep(EVENTS[1])
    journal.begin(found)
    assert kept(tmp_path / "journal") == known(found)


class Disk:
    """A disk with so many bytes, for `write_all`; the files of a folder are on it."""

    def __init__(self, folder: Path, size: int) -> None:
        self.folder, self.size = folder, size

    @property
    def room(self) -> int:
        return self.size - sum(path.stat().st_size for path in self.folder.iterdir())

    def write_all(self, file: FileIO, data: bytes) -> None:
        fits = data[: max(0, self.room)]
        file.write(fits)
        if len(fits) < len(data):
            raise OSError(errno.ENOSPC, "No space left on device")

    def statvfs(self, _: Path) -> SimpleNamespace:
        return SimpleNamespace(f_bavail=max(0, self.room), f_frsize=1)


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Disk:
    found = Disk(tmp_path, 10**9)
    monkeypatch.setattr(memory, "write_all", found.write_all)
    monkeypatch.setattr(memory.os, "statvfs", found.statvfs)
    return found


@pytest.mark.parametrize("step", range(12))
def test_a_disk_may_become_full_at_any_step(
    journal: Journal, tmp_path: Path, disk: Disk, step: int
):
    """A new file that does not fit is removed; the old one goes only if the new one fits then."""
    found = State()
    found.apply(["set", "/a", pack(300 * "x")])
    journal.begin(found)
    before = kept_without_reading_on(tmp_path)
    (tmp_path / "copy").unlink()
    disk.size = (tmp_path / "journal").stat().st_size + 70 * step
    found.apply(["set", "/a", pack(290 * "y")])
    with suppress(OSError):
        journal.keep(["set", "/a", pack(290 * "y")])
    is_open = journal.is_open
    with suppress(OSError):
        journal.begin(found)
    assert [path.name for path in tmp_path.iterdir()] == ["journal"], "nothing is left over"
    assert journal.is_open, "it fits in the place of the old one, or the old one has the event"
    disk.size = 10**9
    assert kept(tmp_path / "journal") == known(found) != before
    assert is_open == (step > 5)


def test_a_file_that_misses_events_stays_while_nothing_fits_in_its_place(
    journal: Journal, tmp_path: Path, disk: Disk
):
    """It is better than none."""
    found = State()
    journal.begin(found)
    disk.size = (tmp_path / "journal").stat().st_size
    found.apply(["set", "/a", pack(300 * "x")])
    for work in (
        partial(journal.keep, ["set", "/a", pack(300 * "x")]),
        partial(journal.begin, found),
    ):
        with pytest.raises(OSError, match="No space left"):
            work()
        assert [path.name for path in tmp_path.iterdir()] == ["journal"]
    assert not journal.is_open
    assert kept(tmp_path / "journal") == known(State())


@pytest.mark.parametrize("step", ["write", "catch_up", "finish"])
@run
async def test_an_error_at_any_step_leaves_nothing_behind(
    journal: Journal, tmp_path: Path, place: Place, monkeypatch: pytest.MonkeyPatch, step: str
):
    """Neither a new file nor events that wait in memory for one; the file goes on."""
    monkeypatch.setattr(memory, "PIECE", 10)
    keeper = await begin(journal, place)
    write = journal.write

    def write_late(events: Any) -> None:
        write(events)
        keep(keeper, EVENTS[1])

    def fail(*_: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(journal, "write", write_late)
    monkeypatch.setattr(journal, step, fail)
    assert not await keeper._write_file()
    assert [path.name for path in tmp_path.iterdir()] == ["journal"]
    assert journal._tail is None
    keep(keeper, EVENTS[0])
    assert keeper.list_troubles() == [], "it has each event"
    assert kept(tmp_path / "journal") == known(keeper.state)


def test_a_new_file_that_a_gate_has_left_is_removed(journal: Journal, tmp_path: Path):
    (tmp_path / "journal.new").write_text("half")
    assert journal.read() is None
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("text", ["", "no base64", base64.b64encode(b"no zlib").decode()])
def test_a_text_of_another_program_is_refused(text: str):
    with pytest.raises(ValueError, match="this gate did not write it"):
        decompress(text)


def test_a_text_of_a_later_gate_is_read_as_far_as_it_goes(state: State):
    lines = [*map(line_of, state.events()), b'["from the future"]\n']
    text = base64.b64encode(zlib.compress(b"".join(lines))).decode()
    assert known(decompress(text)) == known(state)


# -- the keeper --


class Place:
    """The object of the cluster; `fails` are raised by the next writes, one each."""

    def __init__(self, kept: str | None = None) -> None:
        self.kept = kept
        self.fails: list[Exception] = []
        self.writes = 0
        self.taken: list[bool] = []

    def read(self, *, takes_over: bool) -> str | None:
        self.taken.append(takes_over)
        if self.fails:
            raise self.fails.pop(0)
        return self.kept

    def write(self, text: str) -> None:
        try:
            if self.fails:
                raise self.fails.pop(0)
            self.kept = text
        finally:
            self.writes += 1  # at the end: a test waits for it in another thread


@pytest.fixture
def place() -> Place:
    return Place()


class Pauses:
    """A keeper's pauses; each lasts until the test ends it."""

    def __init__(self) -> None:
        self.begun: list[float] = []
        self._go = asyncio.Semaphore(0)

    async def sleep(self, seconds: float) -> None:
        self.begun.append(seconds)
        await self._go.acquire()

    async def until(self, number: int) -> None:
        """Wait for a pause: what comes before it has been done, and nothing is done in it."""
        while len(self.begun) < number:
            await asyncio.sleep(0.001)

    def end(self, number: int = 1) -> None:
        for _ in range(number):
            self._go.release()


async def begin(
    journal: Journal, place: Place, pauses: Pauses | None = None, **more: Any
) -> Keeper:
    """Return a keeper that has found what is left."""
    sleep = pauses.sleep if pauses else asyncio.sleep
    keeper = Keeper(journal, place, program.log, sleep)  # type: ignore[arg-type]
    await keeper.begin(**more)
    return keeper


def keep(keeper: Keeper, event: Event) -> None:
    keeper.state.apply(event)
    keeper.keep(event)


@run
async def test_a_new_pod_finds_what_the_cluster_has(journal: Journal, place: Place, state: State):
    place.kept = packed(state)

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)
    found = journal.read()
    assert found is not None
    assert known(found) == known(state), "and has it in its file from then on"


@run
async def test_the_file_of_the_pod_is_newer_than_the_cluster(
    journal: Journal, place: Place, state: State
):
    """The cluster gets what it lacks: the gate was killed within the second."""
    journal.begin(state)
    place.kept = packed(State())

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)
    await keeper.save()
    assert place.kept is not None
    assert known(decompress(place.kept)) == known(state)


@run
async def test_without_a_memory_the_gate_starts_empty(
    journal: Journal, place: Place, capsys: pytest.CaptureFixture[str]
):
    """The master may know what it does not."""
    place.kept = "no base64"

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(State())
    assert capsys.readouterr().out.startswith("gate: the memory in the cluster is not used: ")


@pytest.mark.parametrize(("failures", "found"), [(2, True), (20, False)])
@run
async def test_a_cluster_that_is_away_is_asked_for_a_while(
    journal: Journal,
    place: Place,
    state: State,
    capsys: pytest.CaptureFixture[str],
    *,
    failures: int,
    found: bool,
):
    """A gate that began with nothing would forget all nodes; but it begins in the end."""
    pauses = Pauses()
    pauses.end(TRIES)
    place.kept = packed(state)
    place.fails += [NotKept("the API server is away")] * failures

    keeper = await begin(journal, place, pauses)
    assert known(keeper.state) == known(state if found else State())
    assert capsys.readouterr().out.count("cannot be read: the API server is away") == failures


@run
async def test_the_cluster_is_written_at_most_once_a_pause(journal: Journal, place: Place):
    """Many changes are one write; without a change there is none."""
    pauses = Pauses()
    keeper = await begin(journal, place, pauses)
    running = asyncio.ensure_future(keeper.run())
    for event in EVENTS:
        keep(keeper, event)
    await pauses.until(1)
    assert place.writes == 1
    assert pauses.begun[0] >= PAUSE
    keep(keeper, ["run", "run 2"])
    keep(keeper, ["run", "run 3"])
    pauses.end()
    await pauses.until(2)
    assert place.writes == 2
    assert place.kept is not None
    assert known(decompress(place.kept)) == known(keeper.state)
    pauses.end()
    for _ in range(10):  # turns of the loop, in which nothing is to be done
        await asyncio.sleep(0)
    assert len(pauses.begun) == place.writes == 2, "nothing has changed since"
    running.cancel()


@run
async def test_a_cluster_that_is_away_is_written_later(
    journal: Journal, place: Place, capsys: pytest.CaptureFixture[str]
):
    """A trouble is reported once, and its end."""
    pauses = Pauses()
    keeper = await begin(journal, place, pauses)
    place.fails += [NotKept("away")] * 3
    keep(keeper, EVENTS[0])
    pauses.end(3)
    running = asyncio.ensure_future(keeper.run())
    await pauses.until(4)
    running.cancel()
    assert place.writes == 4
    assert not keeper._changed.is_set(), "written once, it is not written again"
    assert capsys.readouterr().out.splitlines() == [
        "gate: the memory is not kept in the cluster: away",
        "gate: the memory is kept in the cluster again",
    ]


@run
async def test_a_gate_that_is_overtaken_writes_no_more(
    journal: Journal, place: Place, capsys: pytest.CaptureFixture[str]
):
    """Another pod has the master now."""

    keeper = await begin(journal, place)
    place.fails.append(Overtaken("the gate of pod b writes now"))
    for _ in range(2):
        keep(keeper, EVENTS[0])
        await keeper.save()
    await asyncio.wait_for(keeper._run_cluster(), 60)
    assert place.writes == 1
    assert "the gate of pod b writes now" in capsys.readouterr().out


def noise(size: int) -> str:
    """Return a text that does not become smaller."""
    return base64.b64encode(random.Random(size).randbytes(size)).decode()


@run
async def test_a_memory_that_is_too_large_is_tried_again_after_a_change_only(
    journal: Journal, place: Place, capsys: pytest.CaptureFixture[str]
):
    """The API server would refuse it. Less and less often, until it fits again."""
    why = f"the memory is not kept in the cluster: it has more than {LARGEST} bytes, compressed"
    pauses = Pauses()
    keeper = await begin(journal, place, pauses)
    keep(keeper, ["set", "/a", pack(noise(LARGEST))])
    running = asyncio.ensure_future(keeper.run())
    for number in range(1, 9):
        await pauses.until(number)
        assert not keeper._changed.is_set()
        keep(keeper, ["set", "/b", pack(number)])
        pauses.end()
    await pauses.until(9)
    assert keeper.list_troubles() == [why]
    assert place.writes == 0
    assert all(two >= min(1.9 * one, LONGEST_PAUSE) for one, two in pairwise(pauses.begun))
    assert capsys.readouterr().out == f"gate: {why}\n", "one line, whatever size it has"
    keep(keeper, ["delete", "/a"])
    pauses.end()
    await pauses.until(10)
    running.cancel()
    assert keeper.list_troubles() == []
    assert place.kept is not None
    assert known(decompress(place.kept)) == known(keeper.state)


def test_a_memory_that_is_too_large_is_not_compressed_to_its_end(state: State):
    """It would cost a third of a core, again and again."""
    state.apply(["set", "/big", pack({f"a{number}": noise(50_000) for number in range(100)})])
    left = iter(state.events())
    with pytest.raises(TooLarge, match="more than 100000 bytes"):
        compress(left, 100_000)
    assert sum(event[0] == "set" for event in left) > 90


# -- file or cluster --


@pytest.mark.parametrize("newer", ["file", "cluster"])
@run
async def test_the_copy_with_the_higher_revision_counts(
    journal: Journal, tmp_path: Path, place: Place, state: State, newer: str
):
    """A file on a disk that was full is older than the cluster's copy, and must not replace it."""
    journal.begin(state)
    place.kept = packed(state)
    more: Event = ["set", "/late", pack(1)]
    state.apply(more)
    if newer == "file":
        journal.keep(more)
    else:
        place.kept = packed(state)
    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state) == kept(tmp_path / "journal")
    assert keeper.state.revision == state.revision
    assert place.taken == [False], "the pod that writes is another question"
    await keeper.save()
    assert known(decompress(place.kept)) == known(state)


@run
async def test_a_file_is_used_if_the_cluster_does_not_answer_in_time(
    journal: Journal,
    place: Place,
    state: State,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """A robot without a network must not wait long for its gate."""
    monkeypatch.setattr(keepers, "PATIENCE", 0.01)
    journal.begin(state)
    going = threading.Event()
    place.read = lambda **_: going.wait(60) and None  # type: ignore[method-assign]
    try:
        keeper = await begin(journal, place)
        assert not going.is_set()
    finally:
        going.set()
    assert known(keeper.state) == known(state)
    assert "cannot be compared with the file of the pod: no answer" in capsys.readouterr().out


@pytest.mark.parametrize("old", ["file", "cluster", "both"])
@run
async def test_copies_of_gates_without_revisions_are_read(
    journal: Journal, tmp_path: Path, place: Place, state: State, old: str
):
    """Their file counts, as it did."""
    lines = [line_of(event) for event in state.events() if event[0] != "revision"]
    text = base64.b64encode(zlib.compress(b"".join(lines))).decode()
    assert read_revision(text) == 0
    assert known(decompress(text)) == known(state)
    (tmp_path / "journal").write_bytes(b"".join(lines))
    place.kept = packed(State()) if old == "file" else text
    if old == "cluster":
        journal.begin(state)
    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)


@pytest.mark.parametrize("text", ["no base64", base64.b64encode(b"no zlib").decode()])
@run
async def test_a_damaged_copy_in_the_cluster_leaves_the_file(
    journal: Journal, place: Place, state: State, text: str
):
    journal.begin(state)
    place.kept = text
    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)


@run
async def test_a_file_with_which_gates_were_killed_is_not_read(
    journal: Journal,
    tmp_path: Path,
    place: Place,
    state: State,
    capsys: pytest.CaptureFixture[str],
):
    """The cluster's copy counts, even an older one; the gate says so as long as it runs."""
    place.kept = packed(state)
    later = replay(map(line_of, state.events()))
    later.apply(["set", "/late", pack(1)])
    journal.begin(later)
    keeper = await begin(journal, place, failures=3)
    assert known(keeper.state) == known(state) == kept(tmp_path / "journal")
    why = "3 gates were killed while they began with it"
    assert keeper.notes == [f"the memory in the file of the pod is not used: {why}"]
    assert capsys.readouterr().out == f"gate: {keeper.notes[0]}\n"
    assert place.taken == [False]


@pytest.mark.parametrize("failures", [0, 2, 3, 9])
@run
async def test_a_file_is_all_that_there_is_without_a_copy_in_the_cluster(
    journal: Journal, place: Place, state: State, failures: int
):
    """The gates may have been killed by a person."""
    journal.begin(state)
    keeper = await begin(journal, place, failures=failures)
    assert known(keeper.state) == known(state)
    assert keeper.notes == []
    assert (await begin(journal, place, failures=10)).state.revision == 0


# -- a disk that is full --


@run
async def test_a_full_disk_does_not_stop_the_gate(
    tmp_path: Path, place: Place, capsys: pytest.CaptureFixture[str]
):
    """The cluster still keeps everything; the trouble is reported once."""
    pauses = Pauses()
    journal = Journal(tmp_path / "not there" / "journal")
    keeper = await begin(journal, place, pauses)
    for event in EVENTS:
        keep(keeper, event)
    await keeper.save()
    assert place.kept is not None
    assert known(decompress(place.kept)) == known(keeper.state)
    running = asyncio.ensure_future(keeper._run_file())
    for number in range(1, 8):
        await pauses.until(number)
        pauses.end()
    await pauses.until(8)
    assert pauses.begun == [1, 2, 4, 8, 16, 32, 60, 60]
    (tmp_path / "not there").mkdir()
    pauses.end()
    while keeper.list_troubles():
        await asyncio.sleep(0.001)
    running.cancel()
    assert kept(tmp_path / "not there" / "journal") == known(keeper.state)
    memory.close(journal._file)
    out = capsys.readouterr().out.splitlines()
    assert len(out) == 2
    assert out[0].startswith("gate: the memory is not kept in the file of the pod: ")
    assert out[1] == "gate: the memory is kept in the file of the pod again"


# -- the log --


def test_a_name_makes_no_line_of_its_own(capsys: pytest.CaptureFixture[str]):
    """Nor does it send a terminal commands, turn the text around, or fill the log."""
    program.log("/n\ngate: \x1b[2J\x9b2J \u202e\u2028\ud800 ä at " + 3000 * "x")
    said = capsys.readouterr().out
    assert said.startswith(r"gate: /n\ngate: \x1b[2J\x9b2J \u202e\u2028\ud800 ä at xxx")
    assert said.endswith("x...\n")
    assert len(said) < program.LINE + 100


def test_a_large_word_is_written_in_pieces_as_a_small_one_would_be() -> None:
    event = ["set", "/map", '\u00e9"\\\n\ud800' * (PIECE // 2), True]
    whole = json.dumps(event, ensure_ascii=False)
    assert line_of(event) == whole.encode("utf-8", "surrogatepass") + b"\n"

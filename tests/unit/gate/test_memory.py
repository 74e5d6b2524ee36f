"""What outlives a gate: a file of its pod, a text for the cluster."""

from __future__ import annotations

import asyncio
import base64
import json
import os
import zlib
from collections.abc import Callable, Coroutine, Iterator
from functools import wraps
from pathlib import Path
from typing import Any

import pytest

from rigel_gate import __main__ as program
from rigel_gate import memory
from rigel_gate.__main__ import Keeper
from rigel_gate.cluster import NotKept, Overtaken
from rigel_gate.memory import Journal, compress, decompress, line_of, replay
from rigel_gate.state import Event, State, pack

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
    found._close()


def test_a_state_is_what_its_events_make(state: State):
    assert set(state.registry.nodes) == {"/n", "/lost"}
    assert list(state.newcomers) == [("/n", "http://k:1/")]
    assert (state.leaving, state.silent) == ({"h"}, {"/lost"})
    assert set(state.pods) == {"h", "k"}
    assert state.parameters.tree == {"robot": {"name": "rosie ä", "size": 1.5}}


def test_a_states_own_events_make_it_again(state: State):
    """In lines, as the file has them, and as text for the cluster."""
    assert known(replay(map(line_of, state.events()))) == known(state)
    assert known(decompress(compress(state))) == known(state)
    assert compress(state).isascii()


def test_the_journal_has_each_event_at_once(journal: Journal, tmp_path: Path):
    """A gate that is killed has written what it has answered."""
    assert journal.read() is None
    found = State()
    journal.begin(found)
    for event in EVENTS:
        found.apply(event)
        journal.keep(event, found)
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
    lines.insert(3 if stale.endswith("\n") else len(lines), stale)
    (tmp_path / "journal").write_bytes("".join(lines).encode("utf-8", "surrogateescape"))
    found = journal.read()
    assert found is not None
    assert known(found) == known(state)
    assert found.left_out == 1
    assert compress(found), "what has been read can be written again"


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
    place.kept = compress(state)

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if "is not used" in line] == lines[:1]


@run
async def test_a_damaged_copy_in_the_cluster_costs_its_bad_lines_only(
    journal: Journal, place: Place, state: State, capsys: pytest.CaptureFixture[str]
):
    lines = [*map(line_of, state.events()), "\xff\n", '["silent", null]\n']
    place.kept = base64.b64encode(zlib.compress("".join(lines).encode())).decode()

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state)
    said = capsys.readouterr().out
    assert said == "gate: 2 lines of the memory cannot be read: they are left out\n"


@run
async def test_a_fault_while_saving_does_not_end_saving(
    journal: Journal,
    place: Place,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """Nothing would be kept in the cluster any more, without a word."""
    monkeypatch.setattr(program, "PAUSE", 0.01)

    keeper = await begin(journal, place)
    place.fails.append(RuntimeError("bug"))
    running = asyncio.ensure_future(keeper.run())
    keep(keeper, EVENTS[0])
    await until_written(place, 2)
    await asyncio.sleep(0.1)
    running.cancel()
    assert place.kept is not None
    assert keeper.list_troubles() == []
    assert "the memory is not kept in the cluster: RuntimeError('bug')" in capsys.readouterr().out


def test_the_journal_does_not_grow_for_ever(
    journal: Journal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """A parameter that is set again and again is in it once, from time to time."""
    monkeypatch.setattr(memory, "LINES", 10)
    found = State()
    journal.begin(found)
    for number in range(101):
        event = ["set", "/n", pack(number)]
        found.apply(event)
        journal.keep(event, found)
    assert len((tmp_path / "journal").read_text().splitlines()) <= 12
    again = Journal(tmp_path / "journal").read()
    assert again is not None
    assert again.parameters.tree == {"n": 100}


def test_a_disk_that_is_full_loses_nothing_when_it_has_room_again(journal: Journal, tmp_path: Path):
    found = State()
    journal.begin(found)
    assert journal._file is not None
    journal._file.close()
    journal._file = Path("/dev/full").open("a", buffering=1)  # noqa: SIM115 - the journal closes it
    found.apply(EVENTS[0])
    with pytest.raises(OSError, match="No space left"):
        journal.keep(EVENTS[0], found)
    found.apply(EVENTS[1])
    journal.keep(EVENTS[1], found)
    assert kept(tmp_path / "journal") == known(found)


@pytest.mark.parametrize("text", ["", "no base64", base64.b64encode(b"no zlib").decode()])
def test_a_text_of_another_program_is_refused(text: str):
    with pytest.raises(ValueError, match="this gate did not write it"):
        decompress(text)


def test_a_text_of_a_later_gate_is_read_as_far_as_it_goes(state: State):
    lines = [*map(line_of, state.events()), '["from the future"]\n']
    text = base64.b64encode(zlib.compress("".join(lines).encode())).decode()
    assert known(decompress(text)) == known(state)


# -- the keeper --


class Place:
    """The object of the cluster; `fails` are raised by the next writes, one each."""

    def __init__(self, kept: str | None = None) -> None:
        self.kept = kept
        self.fails: list[Exception] = []
        self.writes = 0

    def read(self) -> str | None:
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


async def begin(journal: Journal, place: Place) -> Keeper:
    """Return a keeper that has found what is left."""
    keeper = Keeper(journal, place)  # type: ignore[arg-type]
    await keeper.begin()
    return keeper


def keep(keeper: Keeper, event: Event) -> None:
    keeper.state.apply(event)
    keeper.keep(event)


@run
async def test_a_new_pod_finds_what_the_cluster_has(journal: Journal, place: Place, state: State):
    place.kept = compress(state)

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
    place.kept = compress(State())

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
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    *,
    failures: int,
    found: bool,
):
    """A gate that began with nothing would forget all nodes; but it begins in the end."""
    monkeypatch.setattr(program, "PAUSE", 0.001)
    place.kept = compress(state)
    place.fails += [NotKept("the API server is away")] * failures

    keeper = await begin(journal, place)
    assert known(keeper.state) == known(state if found else State())
    assert capsys.readouterr().out.count("cannot be read: the API server is away") == failures


async def until_written(place: Place, times: int) -> None:
    """Wait for writes, which a thread makes."""
    while place.writes < times:
        await asyncio.sleep(0.01)


@run
async def test_the_cluster_is_written_at_most_once_a_pause(
    journal: Journal, place: Place, monkeypatch: pytest.MonkeyPatch
):
    """Many changes are one write."""
    monkeypatch.setattr(program, "PAUSE", 0.05)

    keeper = await begin(journal, place)
    running = asyncio.ensure_future(keeper.run())
    for event in EVENTS:
        keep(keeper, event)
    await until_written(place, 1)
    await asyncio.sleep(0.1)
    assert place.writes == 1, "nothing has changed since"
    keep(keeper, ["run", "run 2"])
    await until_written(place, 2)
    running.cancel()
    assert place.kept is not None
    assert known(decompress(place.kept)) == known(keeper.state)


@run
async def test_a_cluster_that_is_away_is_written_later(
    journal: Journal,
    place: Place,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """A trouble is reported once, and its end."""
    monkeypatch.setattr(program, "PAUSE", 0.01)

    keeper = await begin(journal, place)
    place.fails += [NotKept("away")] * 3
    keep(keeper, EVENTS[0])
    running = asyncio.ensure_future(keeper.run())
    await until_written(place, 4)
    await asyncio.sleep(0.1)
    running.cancel()
    assert place.writes == 4, "written once, it is not written again"
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
    await asyncio.wait_for(keeper.run(), 1)
    assert place.writes == 1
    assert "the gate of pod b writes now" in capsys.readouterr().out


@run
async def test_a_memory_that_is_too_large_is_not_written(
    journal: Journal,
    place: Place,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
):
    """The API server would refuse it."""
    monkeypatch.setattr(program, "LARGEST", 10)
    why = "the memory is not kept in the cluster: it has more than 10 bytes, compressed"

    keeper = await begin(journal, place)
    for event in EVENTS:
        keep(keeper, event)
        await keeper.save()
    assert keeper.list_troubles() == [why]
    assert place.writes == 0
    assert capsys.readouterr().out == f"gate: {why}\n", "one line, whatever size it has"


@run
async def test_a_full_disk_does_not_stop_the_gate(
    tmp_path: Path, place: Place, capsys: pytest.CaptureFixture[str]
):
    """The cluster still keeps everything; the trouble is reported once."""
    journal = Journal(tmp_path / "not there" / "journal")

    keeper = await begin(journal, place)
    for event in EVENTS:
        keep(keeper, event)
    await keeper.save()
    assert place.kept is not None
    assert known(decompress(place.kept)) == known(keeper.state)
    (tmp_path / "not there").mkdir()
    keep(keeper, EVENTS[0])
    assert kept(tmp_path / "not there" / "journal") == known(keeper.state)
    journal._close()
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

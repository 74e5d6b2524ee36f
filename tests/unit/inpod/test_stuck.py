"""An executor that stands still: what the layer's files say of it, and the liveness probe."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import attrs
import pytest

import rigel_inpod

READY = Path(rigel_inpod.__file__).parent / "ready.sh"
NS = 10**9
NOW = 1000 * NS
NODE, EXECUTOR = 1, 6
BUSY, WAITING, UNKNOWN = range(3)


@attrs.frozen
class Container:
    """A directory with the file of one process, which is this one."""

    notes: ModuleType
    directory: Path

    def note(self, *executors: tuple[int, float, int], node: str = "/planner") -> None:
        """Write what it notes: for each executor what it does, since when, and with what.

        Its clock is the machine's, which may have started a minute ago.
        """
        notes = self.notes
        fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()
        slots = [notes.SLOT.pack(NODE, *[0] * 3, b"", *[0] * 25, node.encode(), b"")]
        for thread, (doing, seconds, shared) in enumerate(executors):
            last = int((time.monotonic() - seconds) * NS)
            times = [0, 0, 0, 0, last, doing, shared, *[0] * 18]
            slots.append(notes.SLOT.pack(EXECUTOR, 0, thread, 0, b"", *times, b"", b""))
        words = (b"rigelrmw", notes.VERSION, os.getpid(), int(fields[19]), int(fields[25]))
        head = notes.HEAD.pack(*words, 0, len(slots), *[0] * 7, b"")
        text = head.ljust(notes.SLOTS_AT, b"\0") + b"".join(slots)
        (self.directory / "7").write_bytes(text)

    def stands(self) -> float:
        """Seconds for which an executor has not looked for work."""
        (process,) = self.notes.read_all(str(self.directory))
        return round(float(process.stands) / NS)

    def probe(self, seconds: str = "30", *topics: str) -> tuple[int, str]:
        """Return what the liveness probe says."""
        environ = {"PATH": os.environ["PATH"], "RIGEL_RMW": str(self.directory)}
        line = ["/bin/sh", str(READY), "stuck", seconds, *topics]
        done = subprocess.run(line, env=environ, capture_output=True, text=True)
        assert not done.stderr
        return done.returncode, done.stdout.rstrip("\n")


@pytest.fixture
def container(script: Callable[[str], ModuleType], tmp_path: Path) -> Container:
    return Container(script("rmw_notes"), tmp_path)


@pytest.mark.parametrize(
    ("executors", "stands"),
    [
        ([], 0),
        ([(WAITING, 0.5, 0)], 0),
        ([(BUSY, 40, 0)], 40),
        ([(WAITING, 40, 0)], 40),  # it says so each second, if its process runs
        ([(UNKNOWN, 40, 0)], 0),  # it is called when something arrives
        ([(WAITING, 0.5, 1), (BUSY, 40, 1)], 0),  # a thread that waits for its turn to wait
        ([(BUSY, 80, 1), (BUSY, 40, 1)], 40),  # all threads are busy
        ([(WAITING, 0.5, 1), (BUSY, 40, 2)], 40),  # another executor does not help
        ([(WAITING, 0.5, 0), (BUSY, 40, 0)], 40),
    ],
)
def test_an_executor_stands_still(
    container: Container, executors: list[tuple[int, float, int]], stands: int
) -> None:
    """Threads that share their work are one executor: the others wait until one has found some."""
    container.note(*executors)
    assert container.stands() == pytest.approx(stands, abs=20 if stands else 0)


@pytest.mark.programs
def test_the_probe_fails_when_an_executor_has_stood_still_for_so_long(container: Container) -> None:
    """Not before, and its line names the node."""
    container.note((BUSY, 60, 0))
    assert container.probe("3000") == (0, "no executor stands still")
    code, line = container.probe("50")
    assert (code, line[:9]) == (1, "/planner:")
    assert line.endswith(" s")
    container.note((BUSY, 60, 1), (WAITING, 0, 1))
    assert container.probe("50")[0] == 0


def publisher(seconds: float | None, **fields: Any) -> SimpleNamespace:
    """Return a process with a publisher of /scan that has been silent for so long, None: always."""
    last = 0 if seconds is None else NOW - int(seconds * NS)
    scan = SimpleNamespace(kind="publisher", name="/scan", node="/lidar", last=last)
    return SimpleNamespace(
        **{"ended": False, "helper": False, "mode": 0, **fields}, entities=[scan]
    )


@pytest.mark.parametrize(
    ("process", "silent"),
    [
        (publisher(3), True),
        (publisher(1), False),
        (publisher(None), False),  # it has not begun: that is a matter of readiness
        (publisher(3, mode=1), False),  # it waits to take over
        (publisher(3, mode=3), False),  # another one works, and it only finishes its goals
        (publisher(3, ended=True), False),
    ],
)
def test_a_topic_that_was_published_is_silent(
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    process: SimpleNamespace,
    silent: bool,  # noqa: FBT001
) -> None:
    """Only one that works is meant; its line names node and topic."""
    ready = script("rmw_ready")
    monkeypatch.setattr(ready.rmw_notes, "now", lambda: NOW)
    monkeypatch.setattr(ready.rmw_notes, "read_all", lambda _: [process])
    lines = list(ready.find_silent("/x", {"/scan": 2.0}))
    expected = ["/lidar has published nothing on /scan for 3.0 s"]
    assert lines == (expected if silent else [])
    assert list(ready.find_silent("/x", {"/other": 2.0})) == []


@pytest.mark.programs
@pytest.mark.parametrize("words", [("0", "/scan"), ("0", "/scan=fast"), ("soon",)])
def test_wrong_arguments(container: Container, words: tuple[str, ...]) -> None:
    code, line = container.probe(*words)
    assert (code, line) == (2, "wrong arguments: stuck SECONDS [TOPIC=SECONDS...]")


@pytest.mark.programs
def test_without_notes_nothing_is_restarted(container: Container) -> None:
    """The layer may be left out, and a process may have another version's file."""
    assert container.probe()[0] == 0
    (container.directory / "7").write_bytes(b"rigelrmw\xff")
    assert container.probe()[0] == 0
    container.directory.joinpath("7").unlink()
    container.directory.rmdir()
    assert container.probe() == (0, "no executor stands still")

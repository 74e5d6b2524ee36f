"""record.py with a stand-in for ROS 2's recorder, which splits, is killed, fills the disk.

The real recorder of ROS 1 is in tests/ros1/test_record.py.
"""

from __future__ import annotations

import functools
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import rigel_inpod
from tests.support.until import until

pytestmark = pytest.mark.programs

ROOM = Path(rigel_inpod.__file__).parent
#: Begins a file of 1,000 bytes each half a second, and writes metadata when it is interrupted. The
#: file `no messages` makes its bags empty.
ROS2 = r"""#!/usr/bin/env python3
import os, signal, sys, time
here, words = os.path.dirname(os.path.abspath(__file__)), sys.argv[1:]
with open(here + "/calls", "a") as calls:
    calls.write(" ".join(words) + "\n")
if "--help" in words:
    print(open(here + "/help").read())
elif words[:2] == ["bag", "reindex"]:
    paths = [os.path.join(words[2], name) for name in os.listdir(words[2])]
    content = b"".join(open(path, "rb").read() for path in paths)
    if b"broken" in content:  # with or without an exit code, as there are files it does not know
        sys.exit("cannot read it" if b"very" in content else 0)
    count = 0 if os.path.exists(here + "/no messages") else 5
    with open(words[2] + "/metadata.yaml", "w") as file:
        file.write("  starting_time:\n    nanoseconds_since_epoch: 1700000000000000000\n")
        file.write("  message_count: %d\n" % count)
else:
    run = words[words.index("-o") + 1]
    ended = []
    signal.signal(signal.SIGINT, lambda *_: ended.append(1))
    os.mkdir(run)
    number = 0
    while not ended:
        with open("%s/%s_%d.mcap" % (run, os.path.basename(run), number), "wb", 0) as file:
            for _ in range(5):
                file.write(b"x" * 200)
                time.sleep(0 if ended else 0.1)
        number += 1
    open(run + "/metadata.yaml", "w").close()
"""
JAZZY = "--max-bag-duration -s {mcap,sqlite3} --topics --all-topics --storage-config-file"
HUMBLE = "--max-bag-duration -s {mcap,sqlite3} --all"
#: The script with other constants, as one line.
RUN = "import sys; sys.path.insert(0, %r); import record; %s; sys.exit(record.main(sys.argv[1:]))"


class World:
    """A folder of bags, an image, and the recorder's process."""

    def __init__(self, folder: Path) -> None:
        self.bin, self.bags, self.ready = folder / "bin", folder / "bags", folder / "ready"
        self.bags.mkdir()
        self.bin.mkdir()
        self.output = folder / "output"
        (self.bin / "ros2").write_text(ROS2)
        (self.bin / "ros2").chmod(0o755)
        self.provide(JAZZY)
        self.processes: list[subprocess.Popen[bytes]] = []

    def provide(self, options: str) -> None:
        """Set what the recorder's help mentions."""
        (self.bin / "help").write_text(options)

    def line(self, *words: str, more: str = "0") -> list[str]:
        """Return the script's command line."""
        constants = f"record.READY = {str(self.ready)!r}; record.LOOK = 0.1; {more}"
        return [sys.executable, "-c", RUN % (str(ROOM), constants), str(self.bags), *words]

    @property
    def env(self) -> dict[str, str]:
        """The pod's variables, those of ROS 2."""
        path = f"{self.bin}:{os.environ['PATH']}"
        own = {k: v for k, v in os.environ.items() if k not in ("ROS_IP", "ROS_DISTRO")}
        return {**own, "PATH": path, "ROS_DISTRO": "jazzy"}

    def start(self, *words: str, more: str = "0") -> subprocess.Popen[bytes]:
        """Start `run`, in a group of its own."""
        words = words or ("1s", "1000000")
        with self.output.open("ab") as output:
            made = subprocess.Popen(
                self.line("run", *words, more=more),
                env=self.env,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        self.processes.append(made)
        return made

    def list(self) -> list[dict[str, Any]]:
        """Return what `list` prints."""
        done = subprocess.run(self.line("list"), env=self.env, capture_output=True, check=True)
        found: list[dict[str, Any]] = json.loads(done.stdout)
        return found

    def states(self) -> list[str]:
        """Return the bags' states, the oldest first."""
        return [bag["state"] for bag in self.list()]

    def calls(self) -> str:
        """Return the recorder's command lines."""
        return (self.bin / "calls").read_text()

    def expect(self, condition: Callable[[], object], what: str) -> None:
        """Wait for something."""
        until(condition, what, 60, last_words=lambda: (self.output.read_text(), self.list()))

    def stop(self, process: subprocess.Popen[bytes]) -> int:
        """End the recorder as Kubernetes does without a hook."""
        process.terminate()
        return process.wait(60)


@pytest.fixture
def world(tmp_path: Path) -> Iterator[World]:
    """A world whose processes end with the test."""
    made = World(tmp_path)
    yield made
    for process in made.processes:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_each_closed_file_becomes_a_bag(world: World) -> None:
    """It has metadata; the one that is being written is the last, and ends with the recorder."""
    process = world.start()
    expected = ["closed", "closed", "recording"]
    world.expect(lambda: world.states()[-3:] == expected, "closed bags and one that is written")
    world.expect(world.ready.exists, "readiness")
    assert world.stop(process) == 0
    assert set(world.states()) == {"closed"}
    assert not world.ready.exists()
    for bag in world.list():
        folder = world.bags / bag["name"]
        assert (folder / f"{bag['name']}.mcap").stat().st_size == 1000
        assert (folder / "metadata.yaml").exists()
        assert bag["started"] == 1.7e9


def test_a_killed_recorder_is_repaired_at_the_next_start(world: World) -> None:
    """What cannot be repaired is kept, and called so."""
    process = world.start()
    world.expect(lambda: "recording" in world.states(), "a bag")
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    left = [bag for bag in world.list() if bag["state"] == "unclosed"]
    assert left
    run = world.bags / ".runs/2026-01-01-00-00-00"
    run.mkdir()
    (run / "2026-01-01-00-00-00_0.mcap").write_bytes(b"broken")
    (run / "2026-01-01-00-00-00_1.mcap").write_bytes(b"very broken")
    world.start()
    world.expect(lambda: "recording" in world.states(), "the next bag")
    states = {bag["name"]: bag["state"] for bag in world.list()}
    assert {states.get(f"{bag['name']}-repaired") for bag in left} == {"repaired"}
    assert states["2026-01-01-00-00-00_0-damaged"] == "damaged"
    assert states["2026-01-01-00-00-00_1-damaged"] == "damaged"


def test_a_repair_that_was_interrupted_is_done_again(world: World) -> None:
    """The power may fail while a file has its folder and no metadata yet."""
    name = "2026-01-01-00-00-00_0"
    half = world.bags / ".runs" / name
    half.mkdir(parents=True)
    (half / f"{name}.mcap").write_bytes(b"x")
    world.start()
    world.expect(lambda: "repaired" in world.states(), "the repaired bag")
    assert (world.bags / f"{name}-repaired" / "metadata.yaml").exists()


def test_the_limit(world: World) -> None:
    """The oldest closed bags are deleted."""
    world.start("1s", "3500")
    world.expect(lambda: world.output.read_text().count("exceed the limit") >= 2, "deleted bags")
    world.expect(lambda: sum(bag["size"] for bag in world.list()) < 4500, "a small folder")
    assert [bag for bag in world.list() if bag["state"] == "recording"]


def test_empty_bags_are_deleted(world: World) -> None:
    (world.bin / "no messages").touch()
    world.start()
    world.expect(lambda: "has no message and is deleted" in world.output.read_text(), "the line")


def test_a_full_disk_stops_the_recording_until_there_is_room(world: World) -> None:
    """The pod goes on and is not ready, so that bags can be deleted in it."""
    full = world.bags.parent / "full"
    more = (
        f"import os; record.free = lambda _: 7 * 2**20 if os.path.exists({str(full)!r}) else 2**40"
    )
    process = world.start(more=more)
    world.expect(world.ready.exists, "a bag")
    full.touch()
    world.expect(lambda: "is full (7 MiB left)" in world.output.read_text(), "the line")
    assert not world.ready.exists()
    assert set(world.states()) == {"closed"}
    full.unlink()
    world.expect(world.ready.exists, "the next bag")
    assert world.stop(process) == 0


def test_a_recorder_that_ends_by_itself_ends_the_container(world: World) -> None:
    """Kubernetes starts it again, and reports it."""
    (world.bin / "ros2").write_text(ROS2.replace("os.mkdir(run)", "sys.exit(3)"))
    assert world.start(more="record.PATIENCE = 0.1").wait(60) == 1
    assert "the recorder has ended with exit code 3" in world.output.read_text()


@pytest.mark.parametrize(
    ("options", "topics", "expected"),
    [
        (JAZZY, (), "--all-topics"),
        (JAZZY, ("/a", "/b"), "--topics /a /b"),
        (HUMBLE, (), "--all"),
        (HUMBLE, ("/a",), "--max-bag-duration 300 /a"),
    ],
)
def test_the_line_has_the_options_of_the_distribution(
    world: World, options: str, topics: tuple[str, ...], expected: str
) -> None:
    """Later distributions have other options for topics."""
    world.provide(options)
    world.start("300s", "4000000", *topics)
    world.expect(world.ready.exists, "a bag")
    line = next(one for one in world.calls().splitlines() if " -o " in one)
    assert line.endswith(expected)
    assert "bag record -s mcap" in line
    assert "--max-bag-size 1000000 --max-bag-duration 300" in line
    assert ("--storage-config-file" in line) == (options == JAZZY)


@pytest.mark.parametrize("options", [None, "--max-bag-duration -s {sqlite3}"])
def test_an_image_without_the_recorder(world: World, options: str | None) -> None:
    """It names the packages to install."""
    if options is None:
        shutil.rmtree(world.bin)
    else:
        world.provide(options)
    assert world.start().wait(60) == 1
    packages = "ros-jazzy-ros2bag and ros-jazzy-rosbag2-storage-mcap"
    assert f"the image has no rosbag2 with mcap, which records bags: install {packages}" in (
        world.output.read_text()
    )


def test_deleting_is_all_or_nothing(world: World) -> None:
    """A wrong name deletes no bag."""
    process = world.start()
    world.expect(lambda: len(world.states()) >= 2, "bags")
    world.stop(process)
    first, *others = [bag["name"] for bag in world.list()]
    for names, code, left in (([first, "nope"], 1, [first, *others]), ([first], 0, others)):
        done = subprocess.run(world.line("delete", *names), env=world.env, capture_output=True)
        assert done.returncode == code
        assert [bag["name"] for bag in world.list()] == left


def test_only_bags_around_a_fault_are_kept(world: World, tmp_path: Path) -> None:
    """The exporter sees it; the bags before and after it get its name, the others are deleted."""
    metrics = tmp_path / "metrics"
    metrics.write_text('ros_node_up{workload="a"} 1\n')
    handler = functools.partial(SimpleHTTPRequestHandler, directory=str(tmp_path))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever).start()
        more = "record.blackbox.ASK = 0.1; record.blackbox.LATE = 1"
        on = f"--on=crash@127.0.0.1:{server.server_port}"
        process = world.start("1s", "1000000", on, "/a", more=more)
        world.expect(lambda: len(world.list()) >= 3, "files")
        first = world.list()[0]["name"]
        world.expect(lambda: first not in {b["name"] for b in world.list()}, "a deleted file")
        assert set(world.states()) <= {"unclosed", "recording"}
        metrics.write_text('ros_node_up{workload="a"} 0\n')
        world.expect(lambda: world.states().count("crash") >= 3, "bags before and after it")
        kept = {bag["name"] for bag in world.list() if bag["state"] == "crash"}
        world.expect(lambda: len(world.list()) >= len(kept) + 3, "more files")
        server.shutdown()
    assert world.stop(process) == 0
    assert " --topics /a\n" in world.calls()
    assert kept <= {bag["name"] for bag in world.list()}
    for name in kept:
        assert (world.bags / name / "metadata.yaml").exists()
        assert name.endswith("-crash")


def test_no_two_bags_have_one_name(
    script: Callable[[str], ModuleType], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A recorder that begins again in the same second waits for the next one."""
    record = script("record")
    seconds = ["2026-01-01-00-00-01", "2026-01-01-00-00-02"]
    waits: list[float] = []

    def sleep(seconds_of_wait: float) -> None:
        waits.append(seconds_of_wait)
        seconds.pop(0)

    clock = SimpleNamespace(strftime=lambda _: seconds[0], sleep=sleep)
    monkeypatch.setattr(record, "time", clock)
    kind = SimpleNamespace(bags=lambda: [SimpleNamespace(name="2026-01-01-00-00-01_0")])
    record.Recorder(kind, "300s", 2**30, []).wait_for_name()
    assert len(waits) == 1

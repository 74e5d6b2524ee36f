"""dev.sh: the program starts again on request, and ends with the pod."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

import rigel_inpod
from tests.support.until import until

pytestmark = pytest.mark.programs

SCRIPT = Path(rigel_inpod.__file__).parent / "dev.sh"
#: Notes its start, and the signal that ends it.
PROGRAM = "trap 'echo interrupted; exit 3' INT; echo up; while :; do sleep 0.1; done"


#: The program's own shell prints the last one for a child that is met between fork and exec, since
#: that ignores SIGINT for a moment.
EXPECTED = {"up", "interrupted", "[rigel-k8s] started", "", "Terminated"}


class Dev:
    """dev.sh with a program, in a session of its own as in a container."""

    def __init__(self, folder: Path, shell: list[str], *program: str) -> None:
        self.fifo, self.output = folder / "fifo", folder / "output"
        with self.output.open("wb") as out:
            self.process = subprocess.Popen(
                [*shell, str(SCRIPT), str(self.fifo), *program],
                stdout=out,
                stderr=out,
                start_new_session=True,
            )
        until(self.fifo.exists, "FIFO", 60)

    def wait_for(self, text: str, count: int = 1) -> None:
        """Wait until the output has a text so often."""
        until(lambda: self.output.read_text().count(text) >= count, f"{count} times {text}", 60)

    def request(self, word: str = "restart") -> None:
        """Ask for a new start."""
        with os.fdopen(os.open(self.fifo, os.O_RDWR), "w") as requests:
            requests.write(f"{word}\n")

    def end(self) -> int:
        """Send SIGTERM as Kubernetes does, and return the exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(20)

    def list_session(self) -> list[str]:
        """Return the processes of its session, without those that have ended."""
        words = ["ps", "-o", "args=", "-s", str(self.process.pid)]
        found = subprocess.run(words, capture_output=True, text=True).stdout.splitlines()
        return [line for line in found if "<defunct>" not in line]


@pytest.fixture(params=["dash", "bash", "busybox sh"])
def shell(request: pytest.FixtureRequest) -> list[str]:
    """A shell that images have."""
    words: list[str] = request.param.split()
    if not any((Path(p) / words[0]).exists() for p in os.environ["PATH"].split(":")):
        pytest.skip(f"{words[0]} is not installed")
    return words


@pytest.fixture
def started(tmp_path: Path, shell: list[str]) -> Iterator[Dev]:
    one = Dev(tmp_path, shell, "sh", "-c", PROGRAM)
    one.request()
    one.wait_for("up\n")
    yield one
    if one.process.poll() is None:
        os.killpg(one.process.pid, signal.SIGKILL)
        one.process.wait()


def test_a_request_at_once_is_not_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The FIFO is there only when it is open: otherwise the first start would come 30 s later."""
    slow = tmp_path / "bin" / "mkfifo"
    slow.parent.mkdir()
    slow.write_text(f'#!/bin/sh\n{shutil.which("mkfifo")} "$@" && sleep 0.5\n')
    slow.chmod(0o755)
    monkeypatch.setenv("PATH", str(slow.parent), prepend=os.pathsep)
    one = Dev(tmp_path, ["sh"], "sh", "-c", PROGRAM)
    one.request()
    one.wait_for("up\n")
    assert one.end() == 0


def test_without_a_copy_it_starts_by_itself(tmp_path: Path, shell: list[str]) -> None:
    """30 s after its start, by this word; later the word means nothing."""
    one = Dev(tmp_path, shell, "sh", "-c", PROGRAM)
    until(lambda: any("sleep 30" in words for words in one.list_session()), "its clock", 60)
    one.request("first")
    one.wait_for("up\n")
    one.request("first")
    one.request()
    one.wait_for("up\n", 2)
    assert one.output.read_text().count("up\n") == 2
    assert one.end() == 0
    assert one.list_session() == []


def test_it_starts_again_on_request(started: Dev) -> None:
    """By SIGINT, as Ctrl-C in a terminal does."""
    started.request()
    started.wait_for("up\n", 2)
    assert started.output.read_text().count("interrupted") == 1
    started.request()
    started.wait_for("up\n", 3)
    assert set(started.output.read_text().split("\n")) <= EXPECTED


def test_the_end_of_the_pod_ends_it(started: Dev) -> None:
    """SIGTERM reaches this process alone; nothing is left."""
    assert started.end() == 0
    assert "interrupted" in started.output.read_text()
    assert started.list_session() == []


def test_a_program_that_ends_waits_for_the_next_change(tmp_path: Path, shell: list[str]) -> None:
    one = Dev(tmp_path, shell, "sh", "-c", "echo up; exit 7")
    one.request()
    one.wait_for("[rigel-k8s] ended with exit code 7")
    one.request()
    one.wait_for("ended with exit code 7", 2)
    assert one.end() == 0


def test_what_the_program_has_started_ends_with_it(tmp_path: Path, shell: list[str]) -> None:
    """Also one that ignores SIGINT, as the keeper's shell does."""
    line = "(trap '' INT; while :; do sleep 0.1; done) & echo up; wait"
    one = Dev(tmp_path, shell, "sh", "-c", line)
    one.request()
    one.wait_for("up\n")
    one.request()
    one.wait_for("up\n", 2)
    assert sum("while" in words for words in one.list_session()) <= 3
    assert one.end() == 0
    assert one.list_session() == []

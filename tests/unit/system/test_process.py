"""Running other programs: real processes, real signals."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from rigel_k8s.errors import CommandFailed, Interrupted
from rigel_k8s.system import process
from rigel_k8s.system.process import finish, stream, succeeds

pytestmark = pytest.mark.programs


def run(script: str, cancel: threading.Event | None = None, lines: list[str] | None = None) -> None:
    stream(
        ["sh", "-c", script],
        what="the build",
        cancel=cancel or threading.Event(),
        on_line=(lines if lines is not None else []).append,
    )


def test_every_line_is_handed_on() -> None:
    """Both streams, unfinished lines and progress bars come as lines without colours."""
    lines: list[str] = []
    run(r"printf 'a\n\033[31mb\033[0m\r50%%\r100%%\n'; printf 'err\nend' >&2", lines=lines)
    assert lines == ["a", "b", "50%", "100%", "err", "end"]


def test_a_failure_carries_the_last_lines() -> None:
    """The error names what failed and its exit code, and holds the last twenty lines."""
    with pytest.raises(CommandFailed, match=r"the build failed \(exit code 3\)") as caught:
        run("for i in $(seq 30); do echo line $i; done; exit 3")
    assert caught.value.details == tuple(f"line {i}" for i in range(11, 31))


def test_a_program_that_is_not_there_or_may_not_run_is_a_failure(tmp_path: Path) -> None:
    """The error names the program, or what could not be started and why."""
    with pytest.raises(CommandFailed, match=r"^/nonexistent is not installed$"):
        stream(["/nonexistent"], what="it")
    with pytest.raises(CommandFailed, match=r"^nonexistent is not installed$"):
        process.run(["nonexistent"])
    for start in (stream, finish, process.run):
        with pytest.raises(CommandFailed, match=r"the build could not be started: .*denied"):
            start([str(tmp_path)], what="the build")
    gone = tmp_path / "gone"
    with pytest.raises(CommandFailed, match=r"^true could not be started: .*gone"):
        process.run(["true"], cwd=gone)


def test_a_finished_program_is_told_apart_by_its_exit_code() -> None:
    """`finish` gives the code and both outputs; `succeeds` the answer alone."""
    done = finish(["sh", "-c", "echo out; echo err >&2; exit 3"])
    assert (done.code, done.output, done.errors) == (3, "out\n", "err\n")
    assert done.lines == ["out", "err"]
    assert succeeds(["true"])
    assert not succeeds(["false"])


def test_run_gives_the_output_and_raises_where_a_program_fails(tmp_path: Path) -> None:
    """A failure carries what is given to help, and the last lines, standard error's behind."""
    assert process.run(["pwd"], cwd=tmp_path) == f"{tmp_path}\n"
    file = tmp_path / "out"
    assert process.run(["echo", "a"], into=file) == ""
    assert file.read_text() == "a\n"
    script = "for i in $(seq 30); do echo line $i; done; echo why >&2; exit 3"
    with pytest.raises(CommandFailed, match=r"^sh -c for i .* failed \(exit code 3\)$") as caught:
        process.run(["sh", "-c", script], hint="look")
    assert caught.value.hint == "look"
    assert caught.value.details == (*(f"line {i}" for i in range(12, 31)), "why")


def test_the_environment_is_ours_unless_one_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is given is the whole environment."""
    monkeypatch.setenv("OWN", "1")
    show = ["/bin/sh", "-c", "echo $OWN$GIVEN"]
    assert process.run(show) == "1\n"
    assert process.run(show, env={"GIVEN": "2"}) == "2\n"
    lines: list[str] = []
    stream(show, on_line=lines.append)
    stream(show, env={"GIVEN": "2"}, on_line=lines.append)
    assert lines == ["1", "2"]


def test_a_program_that_hangs_is_ended_when_its_time_is_up() -> None:
    """The error says after how long."""
    started = time.monotonic()
    with pytest.raises(CommandFailed, match=r"^the probe did not end within 0\.2 s$"):
        finish(["sleep", "1000"], what="the probe", timeout=0.2)
    assert time.monotonic() - started < 30


def alive(pid: int) -> bool:
    """Whether a process runs (one that is only not reaped yet does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def ended(pid: int) -> bool:
    return not alive(pid)


def wait_for(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 30
    while not condition():
        assert time.monotonic() < deadline, "it did not come to pass in 30 s"
        time.sleep(0.02)


def test_an_interrupted_program_cleans_up_what_its_child_was_for(tmp_path: Path) -> None:
    """podman deletes the containers of a build whose step has failed, not those of its own end."""
    cancel, up, clean = threading.Event(), tmp_path / "up", tmp_path / "clean"

    def cancel_when_up() -> None:
        wait_for(up.exists)
        cancel.set()

    threading.Thread(target=cancel_when_up, daemon=True).start()
    with pytest.raises(Interrupted, match="the build was stopped"):
        run(f"sleep 1000 & touch {up}; wait; echo cleaning up; touch {clean}", cancel)
    assert clean.exists()


@pytest.mark.parametrize("deaf", ["", "trap '' TERM; "])
def test_cancel_ends_the_program_and_its_children(
    deaf: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is left of an interrupted program, not even if it ignores SIGTERM."""
    monkeypatch.setattr("rigel_k8s.system.process.GRACE", 0.3)
    cancel, pids = threading.Event(), tmp_path / "pids"
    script = f"{deaf}sleep 1000 & echo $$ $! > {pids}.new; mv {pids}.new {pids}; echo up; wait"

    def cancel_when_up() -> None:
        wait_for(pids.exists)
        cancel.set()

    threading.Thread(target=cancel_when_up, daemon=True).start()
    with pytest.raises(Interrupted, match="the build was stopped"):
        run(script, cancel)
    for pid in map(int, pids.read_text().split()):
        wait_for(partial(ended, pid))


def test_an_error_of_the_listener_ends_the_program(tmp_path: Path) -> None:
    """Whatever goes wrong while it runs (Ctrl-C too), the program does not go on without us."""
    pids = tmp_path / "pid"

    def fail(_: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stream(["sh", "-c", f"echo $$ > {pids}; echo up; exec sleep 1000"], on_line=fail)
    assert not alive(int(pids.read_text()))


def test_what_a_program_leaves_behind_does_not_hold_us_up() -> None:
    """A background process that keeps the output open does not keep us waiting."""
    lines: list[str] = []
    leave = "import subprocess; print(subprocess.Popen(['sleep', '1000']).pid, flush=True)"
    stream([sys.executable, "-c", leave], on_line=lines.append)
    left = int(lines[0])
    assert alive(left)  # so it was the program's end that we waited for, not its child's
    os.kill(left, signal.SIGKILL)

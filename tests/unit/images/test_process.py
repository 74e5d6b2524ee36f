"""Running docker and podman: real processes, real signals."""

from __future__ import annotations

import os
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from rigel_k8s.errors import CommandFailed, Interrupted
from rigel_k8s.images.process import hint, stream
from tests.support.until import until

ENV = dict(os.environ)


def run(script: str, cancel: threading.Event | None = None, lines: list[str] | None = None) -> None:
    stream(
        ["sh", "-c", script],
        what="the build",
        env=ENV,
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


def test_a_program_that_is_not_there_is_a_failure() -> None:
    """A program that cannot be started is told as such."""
    with pytest.raises(CommandFailed, match="could not be started"):
        stream(["/nonexistent"], what="it", env=ENV, cancel=threading.Event())


def alive(pid: int) -> bool:
    """Whether a process runs (one that is only not reaped yet does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().split(") ")[1][0] != "Z"
    except FileNotFoundError:
        return False


def ended(pid: int) -> bool:
    return not alive(pid)


@pytest.mark.parametrize("deaf", ["", "trap '' TERM; "])
def test_cancel_ends_the_program_and_its_children(
    deaf: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is left of an interrupted program, not even if it ignores SIGTERM."""
    monkeypatch.setattr("rigel_k8s.images.process.GRACE", 0.3)
    cancel, pids = threading.Event(), tmp_path / "pids"
    script = f"{deaf}sleep 1000 & echo $$ $! > {pids}.new; mv {pids}.new {pids}; echo up; wait"

    def cancel_when_up() -> None:
        until(pids.exists, "process", 30, every=0.02)
        cancel.set()

    threading.Thread(target=cancel_when_up, daemon=True).start()
    with pytest.raises(Interrupted, match="the build was stopped"):
        run(script, cancel)
    for pid in map(int, pids.read_text().split()):
        until(partial(ended, pid), f"end of {pid}", 30, every=0.02)


def test_an_error_of_the_listener_ends_the_program(tmp_path: Path) -> None:
    """Whatever goes wrong while it runs (Ctrl-C too), the program does not go on without us."""
    pids = tmp_path / "pid"

    def fail(_: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stream(
            ["sh", "-c", f"echo $$ > {pids}; echo up; exec sleep 1000"],
            what="it",
            env=ENV,
            cancel=threading.Event(),
            on_line=fail,
        )
    assert not alive(int(pids.read_text()))


def test_what_a_program_leaves_behind_does_not_hold_us_up() -> None:
    """A background process that keeps the output open does not keep us waiting."""
    lines: list[str] = []
    begun = time.monotonic()
    leave = "import subprocess; print(subprocess.Popen(['sleep', '1000']).pid, flush=True)"
    stream(
        [sys.executable, "-c", leave],
        what="it",
        env=ENV,
        cancel=threading.Event(),
        on_line=lines.append,
    )
    took = time.monotonic() - begun
    assert alive(int(lines[0]))
    os.kill(int(lines[0]), 9)
    assert took < 60, "of a thousand seconds"


@pytest.mark.parametrize(
    ("line", "way"),
    [
        ("http: server gave HTTP response to HTTPS client", "insecure: true"),
        ("x509: certificate signed by unknown authority", "insecure: true"),
        ("unauthorized: authentication required", "registry provider"),
        ("denied: requested access to the resource is denied", "registry provider"),
        ("exec /bin/sh: exec format error", "qemu-user-static"),
    ],
)
def test_known_failures_have_a_way_out(line: str, way: str) -> None:
    """What docker and podman say often is answered with what to do."""
    assert way in str(hint(["first", line, "last"]))
    assert hint(["something else"]) is None

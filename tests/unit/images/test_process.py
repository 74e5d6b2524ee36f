"""What is shown, kept and advised where docker and podman fail."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from pathlib import Path

import pytest

from rigel_build.process import LOGS, build, hint, stream
from rigel_k8s.errors import CommandFailed, Interrupted

pytestmark = pytest.mark.programs

FAILING = "echo STEP 1/2: FROM a; echo '--> 0123456789a'; echo STEP 2/2: RUN make; seq {}; exit 2"


@pytest.fixture
def logs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the logs of failed builds are kept; nowhere yet."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "rigel-k8s" / "build-logs"


def failed_build(script: str, what: str = "podman build of host:5000/app:1") -> CommandFailed:
    """The error of a build that a shell's script stands for."""
    words = ["sh", "-c", script]
    with pytest.raises(CommandFailed, match=f"^{what} failed") as caught:
        build(words, what=what, env=os.environ, cancel=threading.Event(), on_line=lambda _: None)
    return caught.value


def test_a_failed_build_shows_its_step_and_keeps_the_log(logs: Path) -> None:
    """The cause may stand far above the last lines; the log has what the error leaves out."""
    error = failed_build(FAILING.format(100))
    (log,) = logs.iterdir()
    step = ["STEP 2/2: RUN make", *map(str, range(1, 101))]
    assert error.details == (*step, f"the complete log: {log}")
    assert log.read_text().splitlines() == ["STEP 1/2: FROM a", "--> 0123456789a", *step]
    assert log.stat().st_mode & 0o777 == 0o600
    assert log.name.startswith("podman-build-of-host-5000-app-1-2")


def test_a_failure_before_any_step_shows_the_last_lines(logs: Path) -> None:
    """What is known of docker's and podman's failures has its way out here too."""
    error = failed_build("seq 30; echo unauthorized: authentication required >&2; exit 125")
    (log,) = logs.iterdir()
    last = (*map(str, range(12, 31)), "unauthorized: authentication required")
    assert error.details == (*last, f"the complete log: {log}")
    assert "registry provider" in str(error.hint)


def test_a_program_without_a_word_leaves_no_log(logs: Path) -> None:
    """There is nothing to keep."""
    assert failed_build("exit 1").details == ()
    assert not logs.exists()


def test_only_failed_builds_leave_a_log(logs: Path) -> None:
    """One that succeeds, and one that is interrupted, leave none."""
    cancel, words = threading.Event(), ["sh", "-c", "echo STEP 1/1: RUN sleep; exec sleep $0"]
    lines: list[str] = []
    build([*words, "0"], what="it", env=os.environ, cancel=cancel, on_line=lines.append)
    assert lines == ["STEP 1/1: RUN sleep"]

    def stop(_: str) -> None:
        cancel.set()

    with pytest.raises(Interrupted):
        build([*words, "99"], what="it", env=os.environ, cancel=cancel, on_line=stop)
    assert not logs.exists()


def test_old_logs_make_room(logs: Path) -> None:
    """So many of the newest stay."""
    logs.mkdir(parents=True)
    for age in range(LOGS + 5):
        (logs / f"{age}.log").touch()
        os.utime(logs / f"{age}.log", (1e9 - age, 1e9 - age))
    failed_build(FAILING.format(1))
    left = {log.name for log in logs.iterdir()}
    assert len(left) == LOGS
    assert left > {f"{age}.log" for age in range(LOGS - 1)}


def test_a_log_that_cannot_be_kept_hides_no_failure(logs: Path) -> None:
    """The error shows the step, and why there is no log."""
    logs.parent.parent.write_text("a file where the cache's directory should be")
    details = failed_build(FAILING.format(1)).details
    assert details[:2] == ("STEP 2/2: RUN make", "1")
    assert details[2].startswith("the complete log could not be written: ")


@pytest.mark.skipif(shutil.which("podman") is None, reason="podman is not installed")
def test_the_real_podman_is_understood(logs: Path, tmp_path: Path) -> None:
    """Its step that fails is shown alone, with its end."""
    file = tmp_path / "Dockerfile"
    file.write_text("FROM scratch\nLABEL a=b\nCOPY missing /missing\nLABEL c=d\n")
    with tempfile.TemporaryDirectory(prefix="rigel-") as own:  # podman refuses long names for it
        podman = f"podman --root {own}/a --runroot {own}/b --storage-driver vfs build {tmp_path}"
        error = failed_build(f"BUILDAH_ISOLATION=chroot exec {podman}")
    (log,) = logs.iterdir()
    first, *others, last = error.details
    assert first == "STEP 3/4: COPY missing /missing"
    assert 'building at STEP "COPY missing /missing"' in others[-1]
    assert not [line for line in others if line.startswith("STEP")]
    assert last == f"the complete log: {log}"
    assert "LABEL a=b" in log.read_text()


def test_a_known_failure_of_a_program_has_a_way_out() -> None:
    """The error keeps what failed and the last lines, and says what helps."""
    words = ["sh", "-c", "echo 1; echo unauthorized: authentication required >&2; exit 125"]
    with pytest.raises(CommandFailed, match=r"^the push failed \(exit code 125\)$") as caught:
        stream(words, what="the push", env=os.environ, cancel=threading.Event())
    assert caught.value.details == ("1", "unauthorized: authentication required")
    assert "registry provider" in str(caught.value.hint)


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

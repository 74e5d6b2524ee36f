"""keep.sh: what starts roscore again, and what is left to Kubernetes."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

import rigel_inpod

pytestmark = pytest.mark.programs

KEEP = Path(rigel_inpod.__file__).parent / "keep.sh"

#: Moves the clock on by the seconds of its line in `lives`; ends with the line's code.
PROGRAM = """
here=${0%/*}
echo start >>"$here/starts"
set -- $(sed -n "$(wc -l <"$here/starts")p" "$here/lives")
[ "$1" = stopped ] && kill -INT "$PPID" && set -- 20 0
read -r now _ <"$here/uptime"
echo "$((${now%.*} + $1)).25 7.0" >"$here/uptime"
exit "$2"
"""


@pytest.fixture
def keep(tmp_path: Path) -> Callable[[str], tuple[int, int]]:
    """Run programs with these lives, one a line: seconds and exit code; return (code, starts)."""
    (tmp_path / "keep.sh").write_text(
        KEEP.read_text().replace("/proc/uptime", str(tmp_path / "uptime"))
    )
    (tmp_path / "program.sh").write_text(PROGRAM)
    (tmp_path / "uptime").write_text("1000.25 7.0\n")

    def run(lives: str, **env: str) -> tuple[int, int]:
        (tmp_path / "lives").write_text(lives)
        line = ["sh", str(tmp_path / "keep.sh"), "sh", str(tmp_path / "program.sh")]
        code = subprocess.run(line, timeout=60, env={**os.environ, **env}).returncode
        return code, len((tmp_path / "starts").read_text().splitlines())

    return run


def test_a_program_that_cannot_run_is_for_kubernetes(keep: Callable[[str], tuple[int, int]]):
    """It ends the container with its own exit code, so that the cause can be reported."""
    assert keep("2 127") == (127, 1)


def test_a_program_that_has_lived_is_started_again(keep: Callable[[str], tuple[int, int]]):
    assert keep("10 0\n60 137\n9 3") == (3, 3)


def test_a_program_that_was_stopped_is_not_started_again(
    keep: Callable[[str], tuple[int, int]],
):
    assert keep("30 1\nstopped") == (0, 2)


def test_a_stop_that_comes_after_the_programs_end_counts(
    keep: Callable[..., tuple[int, int]], tmp_path: Path
):
    """The stop hook ends the program first; this process waits a moment for its own signal."""
    sleep = tmp_path / "bin" / "sleep"
    sleep.parent.mkdir()
    sleep.write_text('#!/bin/sh\nkill -INT "$PPID"\n')
    sleep.chmod(0o755)
    assert keep("30 4\n9 3", PATH=f"{sleep.parent}:{os.environ['PATH']}") == (4, 1)


def test_signals_do_not_end_it_before_its_program(tmp_path: Path):
    """SIGTERM reaches this process alone; roscore goes on until the stop hook has ended it."""
    line = ["sh", str(KEEP), "sh", "-c", "echo up; read -r _; exit 5"]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as kept:
        assert kept.stdin is not None
        assert kept.stdout is not None
        assert kept.stdout.readline() == "up\n"
        os.kill(kept.pid, signal.SIGTERM)
        kept.stdin.write("\n")
        kept.stdin.flush()
        assert kept.wait(10) == 5

"""What `./run test` runs, and its exit code, which is all that continuous integration looks at."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.programs

RUN = Path(__file__).parents[2] / "run"
#: Ends the tests with the code in CODE, everything else with 0 and at once.
PROGRAM = """#!/bin/sh
echo "$0 $*" >>"$CALLS"
case "$*" in *pytest*|*tests.tiers*) exit $CODE ;; esac
"""
LOCKED = ("requirements/build.txt", "requirements/dev.txt")
#: apt-get too: a machine without some of the packages would wait for them.
PROGRAMS = ("python", "ruff", "mypy", "lint-imports", "cargo", "apt-get")


@pytest.mark.parametrize("code", [0, 1])
def test_the_tests_decide(tmp_path: Path, code: int) -> None:
    """Their exit code is that of the run."""
    run(tmp_path, code=code)


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        ([], ["tests.tiers --lint N"]),
        (["--all"], ["tests.tiers --lint N --all"]),
        (["--slow"], ["tests.tiers --slow"]),
        (["tests/unit", "-k", "name"], ["pytest -n 2 tests/unit -k name"]),
    ],
)
def test_the_tiers_of_a_run(tmp_path: Path, words: list[str], parts: list[str]) -> None:
    """Each has lint before it, but for the tests that somebody names."""
    calls = run(tmp_path, *words).splitlines()
    # The seconds that lint took are not those of a fast machine.
    calls = [re.sub(r"--lint \d+", "--lint N", line) for line in calls]
    modules = [line.partition("/python -m ")[2] for line in calls]
    assert [one for one in modules if one.startswith(("pytest", "tests."))] == parts
    assert any("ruff check" in line for line in calls) == (words in ([], ["--all"]))


def run(directory: Path, *words: str, code: int = 0) -> str:
    """Run `./run test`, whose tests end with a code; return the programs that it has called."""
    root = directory / "project"
    programs = root / ".venv/bin"
    programs.mkdir(parents=True)
    for program in (programs / name for name in PROGRAMS):
        program.write_text(PROGRAM)
        program.chmod(0o755)
    for name in (*LOCKED, "pyproject.toml", "hatch_build.py", "src/rigel_rmw/layer.c"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("")
    (root / ".venv/.installed-dev").write_text(f"{hashlib.sha256(b'').hexdigest()}  -\n")
    shutil.copy(RUN, root)
    (root / "tools").mkdir()
    shutil.copy(RUN.parent / "tools/steps.sh", root / "tools")
    path = f"{programs}:{os.environ['PATH']}"
    own = {"CODE": str(code), "CALLS": str(directory / "calls"), "RIGEL_VENV": "", "PATH": path}
    done = subprocess.run(
        [root / "run", "test", *words],
        env={**os.environ, **own},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == code, done.stderr
    return (directory / "calls").read_text()

"""The exit code of `./run test`, which is all that continuous integration looks at."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

pytestmark = pytest.mark.programs

RUN = Path(__file__).parents[2] / "run"
#: Ends the tests with the code in CODE, everything else with 0 and at once.
PROGRAM = """#!/bin/sh
case "$*" in *pytest*) sleep 0.2; exit $CODE ;; esac
"""
PROGRAMS = ("python", "ruff", "mypy", "lint-imports", "cargo")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root's run builds beside the tests")
@pytest.mark.parametrize("code", [0, 1])
def test_the_tests_decide(tmp_path: Path, code: int) -> None:
    """Whether or not the builds beside them have ended by then."""
    root = tmp_path / "project"
    programs = root / ".venv/bin"
    programs.mkdir(parents=True)
    for name in PROGRAMS:
        (programs / name).write_text(PROGRAM)
        (programs / name).chmod(0o755)
    (root / "requirements").mkdir()
    for name in ("requirements/build.txt", "requirements/dev.txt", "pyproject.toml"):
        (root / name).write_text("")
    (root / ".venv/.installed-dev").write_text(f"{hashlib.sha256(b'').hexdigest()}  -\n")
    shutil.copy(RUN, root)
    (root / "tools").mkdir()
    shutil.copy(RUN.parent / "tools/steps.sh", root / "tools")
    done = subprocess.run(
        [root / "run", "test"],
        env={**os.environ, "CODE": str(code), "RIGEL_VENV": "", "RIGEL_TEST_CONTEXT": ""},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == code, done.stderr

"""Rigel 0.3 itself, in an environment of its own, runs job types of this package.

RIGEL03_PYTHON names that environment's interpreter. Rigel 0.3 is not on PyPI; docs/rigel.md says
how to install it beside this package.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from .rigelfiles import DOCKERFILE

PYTHON = os.environ.get("RIGEL03_PYTHON", "")

pytestmark = pytest.mark.skipif(
    not PYTHON, reason="RIGEL03_PYTHON names no interpreter of an environment with Rigel 0.3"
)


@pytest.fixture
def here(tmp_path: Path) -> Path:
    (tmp_path / "Rigelfile").write_text(DOCKERFILE)
    return tmp_path


def rigel(here: Path, *words: str, file: str = "") -> subprocess.CompletedProcess[str]:
    """Run Rigel's own command line."""
    return subprocess.run(
        [PYTHON, "-m", "rigel.main", *words],
        cwd=here,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def test_rigel_runs_a_job_of_ours(here: Path) -> None:
    """From the same Rigelfile, filter and all."""
    done = rigel(here, "run", "job", "dockerfile")
    assert done.returncode == 0, done.stderr
    text = (here / "Dockerfile").read_text()
    assert "ros:1.10" in text
    assert '"roslaunch", "a", "b.launch"' in text


def test_rigel_runs_a_sequence_of_ours(here: Path) -> None:
    """With the overrides of the place of use."""
    done = rigel(here, "run", "sequence", "build")
    assert done.returncode == 0, done.stderr
    assert '"rosrun", "c", "d"' in (here / "Dockerfile").read_text()


def test_rigel_tells_what_is_wrong_with_our_words(here: Path) -> None:
    """Line, column, and Rigel's exit code."""
    done = rigel(here, "run", "job", "deploy")
    assert done.returncode == 1
    assert "Rigelfile:21:18:" in done.stderr
    assert "Not_A_Name" in done.stderr
    assert "Traceback" not in done.stderr


def test_nothing_of_the_environment_is_broken() -> None:
    """`pip check` is clean with both installed."""
    subprocess.run([PYTHON, "-m", "pip", "check"], check=True)

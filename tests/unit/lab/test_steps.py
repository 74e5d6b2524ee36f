"""What `rigel cluster up` shows while it compiles: a real program, built as Kubernetes is."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rigel_lab.cluster.gobuild import GO_VERSION, go_version
from tests.support.terminal import open_terminal

pytestmark = pytest.mark.programs

#: Builds a module of one program, and waits for a file.
BUILD = """
import sys
import time
from contextlib import closing
from pathlib import Path
from rigel_k8s.cli.reports import reporter
from rigel_lab.cli.steps import Steps
from rigel_lab.cluster.gobuild import GoBuild

class Hello(GoBuild):
    lock = Path(sys.argv[1])

with reporter() as shown, closing(Steps(shown)) as steps:
    steps.line("Preparing")
    Hello("hello", "1.0.0", ("robot.example/hello",)).build(steps.line)
    while not Path(sys.argv[2]).exists():
        time.sleep(0.1)
"""
#: A line of its own makes the program new, so that Go does not take it from its cache.
PROGRAM = 'package main\n\nfunc main() {{ println("{place}") }}\n'


@pytest.fixture
def module(tmp_path: Path) -> Path:
    """A Go module of one program."""
    found = shutil.which("go")
    if not found or go_version(found) < GO_VERSION:
        pytest.skip("no Go toolchain that is new enough")
    place = tmp_path / "module"
    place.mkdir()
    (place / "go.mod").write_text("module robot.example/hello\n\ngo 1.26\n")
    (place / "go.sum").touch()
    (place / "main.go").write_text(PROGRAM.format(place=tmp_path))
    return place


def test_a_terminal_shows_what_is_built_and_for_how_long(module: Path, tmp_path: Path) -> None:
    """One row moves; afterwards each step is a line, and nothing else stays."""
    environment = {"XDG_CACHE_HOME": str(tmp_path), "NO_COLOR": "", "FORCE_COLOR": ""}
    words = [sys.executable, "-c", BUILD, str(module), str(tmp_path / "end")]
    terminal = open_terminal(words, environment)
    terminal.until("packages", 120)
    terminal.until(" 1s")
    terminal.until(" 2s")
    row = terminal.screen()[-1]
    assert re.fullmatch(r"   Building hello: \d+ of \d+ packages +\d+s", row), row
    (tmp_path / "end").touch()
    assert terminal.end() == 0
    lines = [re.sub(r"^ +\d+ s  ", "", line) for line in terminal.screen() if line]
    assert lines == [
        "Preparing",
        "Compiling hello 1.0.0 from source (about 1 minute on two cores, once)",
        "Building hello 1.0.0: fetching its modules",
    ]


def test_a_pipe_gets_lines(module: Path, tmp_path: Path) -> None:
    """Each step when it begins; nothing moves."""
    done = subprocess.run(
        [sys.executable, "-c", BUILD, str(module), str(module)],
        env={**os.environ, "XDG_CACHE_HOME": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=300,
    )
    assert "\x1b" not in done.stderr
    assert "\r" not in done.stderr
    steps = [line for line in done.stderr.splitlines() if " packages" not in line]
    assert [re.sub(r"^ +\d+ s  ", "", line) for line in steps] == [
        "Preparing",
        "Compiling hello 1.0.0 from source (about 1 minute on two cores, once)",
        "Building hello 1.0.0: fetching its modules",
    ]

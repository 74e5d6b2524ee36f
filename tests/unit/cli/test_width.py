"""How many columns an error uses: those of the terminal, or 160."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from pathlib import Path

import click
import pytest

from rigel_k8s.cli import width

pytestmark = pytest.mark.programs

LONG = "{jobs: {deploy: {with: {" + ", ".join(f"key{i}: 1" for i in range(500)) + "}}}}"


@pytest.mark.parametrize("words", [["check"], ["run", "job", "deploy"]])
@pytest.mark.parametrize("columns", [60, 200])
def test_lines_of_the_file_fit_the_terminal(words: list[str], columns: int, tmp_path: Path) -> None:
    """Neither standard output nor an error breaks a line of the Rigelfile."""
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    run(words, tmp_path, theirs)
    os.close(theirs)
    shown = click.unstyle(read(ours)).splitlines()
    assert max(len(line) for line in shown if " | " in line) == columns


@pytest.mark.parametrize("words", [["check"], ["run", "job", "deploy"]])
def test_a_file_gets_160_columns(words: list[str], tmp_path: Path) -> None:
    """What is no terminal has no width of its own."""
    with (tmp_path / "output").open("w+") as output:
        run(words, tmp_path, output.fileno())
        output.seek(0)
        lines = output.read().splitlines()
    assert max(len(line) for line in lines if " | " in line) == 160


@pytest.mark.parametrize("columns", range(10, 90))
def test_a_command_in_backquotes_stays_on_one_line(
    columns: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So it can be copied; one that is longer than the terminal is broken as other words are."""
    monkeypatch.setattr(width, "find_room", lambda _: columns)
    command = "`rigel -n robots rbac deployer --user YOU`"
    text = f"ask an administrator for the rights: {command}, which grants all of them"
    lines = width.wrap(text, sys.stderr, indent=7).split("\n")
    assert " ".join(lines) == text
    assert any(command in line for line in lines) == (len(command) <= columns)
    assert all(len(line) <= columns or len(line.split("`")) > 1 for line in lines if " " in line)


def run(words: list[str], directory: Path, output: int) -> None:
    """Run a command that finds the file wrong."""
    (directory / "Rigelfile").write_text(LONG)
    command = [sys.executable, "-m", "rigel_k8s", *words]
    done = subprocess.run(command, cwd=directory, stdout=output, stderr=output, check=False)
    assert done.returncode == 2


def read(terminal: int) -> str:
    """Return what was written to a terminal whose other side is closed."""
    text = b""
    try:
        while part := os.read(terminal, 4096):
            text += part
    except OSError:  # how Linux reports the end
        pass
    finally:
        os.close(terminal)
    return text.decode()

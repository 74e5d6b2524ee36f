"""How a run tells how it goes, in a terminal and elsewhere."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys

import pytest

from rigel_k8s.cli.reports import Lines

TALK = """
from rigel_k8s.cli.reports import reporter
with reporter() as report:
    report.line("first")
    report.progress("Deployment talker", "0/1 ready")
    report.progress("Deployment listener", "0/1 ready")
    report._live.refresh()  # instead of the eighth of a second that a look takes
    report.child("robot=a").progress("job", "working")
    report.progress("Deployment talker", "1/1 ready", done=True)
    report.warn("look at this")
    report._live.refresh()
"""


def test_lines_tell_only_changes(capsys: pytest.CaptureFixture[str]) -> None:
    """A log of a CI run has a line per change, not per look."""
    report = Lines()
    for state in ("0/1", "0/1", "0/1", "1/1"):
        report.progress("talker", state, done=state == "1/1")
    report.progress("talker", "", done=True)
    assert capsys.readouterr().err.splitlines() == ["  talker: 0/1", "✓ talker: 1/1"]


def test_children_are_told_apart(capsys: pytest.CaptureFixture[str]) -> None:
    """Branches that run side by side have their name before every line."""
    report = Lines()
    report.child("robot=a").line("one\ntwo")
    report.child("robot=b").child("build").line("three")
    assert capsys.readouterr().err.splitlines() == [
        "[robot=a] one",
        "[robot=a] two",
        "[robot=b] [build] three",
    ]


def test_quiet_still_warns(capsys: pytest.CaptureFixture[str]) -> None:
    """-q takes progress away, never a warning."""
    report = Lines(quiet=True)
    report.line("progress")
    report.progress("talker", "1/1")
    report.child("b").line("progress")
    report.child("b").warn("beware")
    assert capsys.readouterr().err == "[b] warning: beware\n"


@pytest.mark.programs
def test_a_terminal_gets_rows_that_change_and_lines_that_stay() -> None:
    """In a real terminal rows are redrawn in place; what is done stays as a line."""
    leader, follower = pty.openpty()
    child = subprocess.Popen(
        [sys.executable, "-c", TALK],
        stdin=follower,
        stdout=follower,
        stderr=follower,
        env={**os.environ, "TERM": "xterm", "NO_COLOR": ""},
    )
    os.close(follower)
    written = b""
    while True:
        try:
            chunk = os.read(leader, 4096)
        except OSError:
            break
        if not chunk:
            break
        written += chunk
    os.close(leader)
    assert child.wait() == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.decode())
    assert "\x1b[" in written.decode(), "rows are redrawn with control sequences"
    assert "Deployment listener 0/1 ready" in re.sub(" +", " ", text)
    assert "[robot=a] job" in text
    assert "✓ Deployment talker: 1/1 ready" in text
    assert "warning: look at this" in text

"""bench.fleets: a step that fails or is too slow is a row of the table."""

from __future__ import annotations

import sys

import pytest

from bench.fleets import Outcome, describe
from bench.measure import CommandFailed, Sample, TooSlow, run

pytestmark = pytest.mark.programs


def python(program: str) -> list[str]:
    """Return the command line of a program."""
    return [sys.executable, "-S", "-c", program]


def test_a_command_that_fails_says_what_it_printed() -> None:
    """The bench's standard error has the cause."""
    with pytest.raises(CommandFailed, match=r"exited 3\nno such image"):
        run(python("print('no such image'); raise SystemExit(3)"))


def test_a_command_that_takes_too_long_is_ended() -> None:
    """One tool that hangs does not take the others' time."""
    with pytest.raises(TooSlow):
        run(python("import time; time.sleep(600)"), limit=0.2)


def test_a_row_says_which_tool_failed_and_has_the_others_figures() -> None:
    """A failed step costs its own figures only."""
    outcomes = [Outcome("", Sample(2.04, 1.5, 40)), Outcome("failed"), None]
    assert describe(outcomes) == "2.0 / failed / - | 1.50 / - / - | 40 / - / -"

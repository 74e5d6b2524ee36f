"""bench.scale: a step that fails or is too slow is a row of the table, and requests are counted."""

from __future__ import annotations

import sys

import pytest

from bench.measure import CommandFailed, Sample, TooSlow, run
from bench.requests import count_in
from bench.scale import Outcome, Shape, describe

METRICS = """\
apiserver_flowcontrol_dispatched_requests_total{flow_schema="exempt",priority_level="exempt"} 800
apiserver_flowcontrol_dispatched_requests_total{flow_schema="rigel-bench",priority_level="exempt"} 7
apiserver_request_total{code="200",resource="pods",subresource="",verb="LIST",version="v1"} 90
apiserver_request_total{code="200",resource="pods",subresource="log",verb="GET",version="v1"} 2
apiserver_request_total{code="200",resource="pods",subresource="log",verb="CONNECT"} 1.2e+01
"""


def python(program: str) -> list[str]:
    """Return the command line of a program."""
    return [sys.executable, "-S", "-c", program]


def test_only_the_counted_users_requests_and_logs_count() -> None:
    """The API server's own components send most of the requests."""
    assert count_in(METRICS) == 7 + 2 + 12


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
    outcomes = [Outcome("", Sample(2.04, 1.5, 40), 12), Outcome("failed"), None]
    row = describe(Shape(robots=10, nodes=5), outcomes)
    assert row == "2.0 / failed / - | 1.50 / - / - | 40 / - / - | 12 / - / - | 30.0 / - / -"

"""Times of log lines."""

from __future__ import annotations

import pytest

from rigel_k8s.commands.logs.lines import LogLine, sort_lines, split_stamp, stamp


@pytest.mark.parametrize(
    ("line", "time", "text"),
    [
        ("1970-01-01T00:00:01.000000002Z hello", 1_000_000_002, "hello"),
        ("1970-01-01T01:00:01.5+01:00  two  blanks ", 1_500_000_000, " two  blanks "),
        ("1970-01-01T00:00:01Z ", 1_000_000_000, ""),
        ("unable to retrieve container logs", None, "unable to retrieve container logs"),
    ],
)
def test_a_line_has_its_time_before_it(line: str, time: int | None, text: str) -> None:
    """To the nanosecond, in any zone; the line itself stays as it is."""
    assert split_stamp(line) == (time, text)


def test_a_time_is_written_as_kubernetes_does() -> None:
    """In nine digits, so that times sort as text."""
    assert stamp(1_000_000_002) == "1970-01-01T00:00:01.000000002Z"


def line(time: int, text: str) -> LogLine:
    return LogLine("w", "p", text, time=time)


def test_lines_that_were_written_down_late_come_by_time() -> None:
    """Standard output and error are read by two hands; notes have no time and do not wait."""
    tenth = 100_000_000
    lines = [line(40 * tenth, "b"), line(39 * tenth, "a"), LogLine("w", "p", "note", note=True)]
    lines += [line(70 * tenth, "d"), line(69 * tenth, "c")]
    assert [one.text for one in sort_lines(lines)] == ["note", "a", "b", "c", "d"]

"""Times of log lines, and two sources of the same lines as one."""

from __future__ import annotations

import pytest

from rigel_k8s.commands.logs.lines import LogLine, merge_lines, sort_lines, split_stamp, stamp


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


def line(time: int, text: str, *, pod: str = "p", part: int = 0) -> LogLine:
    return LogLine("w", pod, text, time=time, part=part)


def texts(stored: list[LogLine], fresh: list[LogLine]) -> list[str]:
    return [one.text for one in merge_lines(stored, fresh)]


def test_what_is_in_both_is_told_once_and_in_order() -> None:
    """The same text at another time, or of another pod, is another line."""
    stored = [line(1, "a"), line(2, "b"), line(2, "b", pod="q"), line(4, "b")]
    fresh = [line(2, "b"), line(3, "c"), line(4, "b"), line(5, "b")]
    assert texts(stored, fresh) == ["a", "b", "b", "c", "b", "b"]


def entry(time: int) -> list[LogLine]:
    return [line(time, text, part=n) for n, text in enumerate(("boom", "  at 1", "Error"))]


def test_a_traceback_is_one_entry_in_loki_and_three_lines_in_the_container() -> None:
    """Its further lines have times of their own there; they are the same lines."""
    fresh = [line(10, "boom"), line(11, "  at 1"), line(12, "Error"), line(13, "on")]
    assert texts(entry(10), fresh) == ["boom", "  at 1", "Error", "on"]


def test_a_traceback_that_loki_has_not_got_is_told_though_the_one_before_is_the_same() -> None:
    """Only what belongs to an entry that both have is left out."""
    fresh = [line(10, "boom"), line(11, "  at 1"), line(12, "Error")]
    assert texts(entry(1), fresh) == ["boom", "  at 1", "Error"] * 2
    both = [line(1, "boom"), line(2, "  at 1"), line(3, "Error"), *fresh]
    assert texts(entry(1), both) == ["boom", "  at 1", "Error"] * 2


def test_lines_that_were_written_down_late_come_by_time() -> None:
    """Standard output and error are read by two hands; notes have no time and do not wait."""
    tenth = 100_000_000
    lines = [line(40 * tenth, "b"), line(39 * tenth, "a"), LogLine("w", "p", "note", note=True)]
    lines += [line(70 * tenth, "d"), line(69 * tenth, "c")]
    assert [one.text for one in sort_lines(lines)] == ["note", "a", "b", "c", "d"]


def test_what_was_written_down_late_is_still_the_same_line() -> None:
    """Loki tells by time, the API server as it was written down."""
    stored = [line(1, "a"), line(2, "b"), line(3, "c")]
    assert texts(stored, list(sort_lines([line(2, "b"), line(1, "a"), line(3, "c")]))) == [*"abc"]

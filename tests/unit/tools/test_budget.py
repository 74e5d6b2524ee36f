"""The budget: what counts, and what is said about a house that has grown too large."""

from __future__ import annotations

import pytest

from tools.budget import compare, find_tag, measure, read_tag, read_tree

FILES = [
    ("src/one/a.py", b"a\nb\n"),
    ("src/one/b.sh", b"c\n"),
    ("src/two/c.py", b"d\n"),
    ("src/two/page.js", b"not counted\n"),
    ("tests/unit/app/golden/x.yaml", b"a: 1\nb: 2\n"),
    ("tests/unit/app/other.yaml", b"not: counted\n"),
    ("docs/a.md", b"three plain words\n"),
    ("docs/guides/b.md", b"two words\n"),
]


def test_lines_of_houses_and_words_of_pages_count() -> None:
    """Other files do not."""
    expected = {"one": 3, "two": 1, "src": 4, "golden": 2, "words": 5, "pages": 2}
    assert measure(FILES) == expected


def test_what_is_over_its_limit_is_named_with_the_way_out() -> None:
    """At the limit nothing is."""
    table, over = compare({"one": 3, "two": 0}, {"one": 3, "two": 1}, {}, "")
    assert table == ["     now  limit", "one    3      3", "two    1      0"]
    assert [line.partition(":")[0] for line in over] == ["two"]
    assert "raise [tool.rigel.budget]" in over[0]


def test_the_last_tag_stands_beside_today() -> None:
    """A house that the tag did not have had no lines."""
    table, _ = compare({"one": 9, "two": 9}, {"one": 3, "two": 1}, {"one": 1234}, "0.1.0")
    assert table[1:] == ["one  1,234    3      9", "two      0    1      9"]


@pytest.mark.programs
def test_a_commit_is_measured_like_the_working_tree() -> None:
    """As far as both have the same files; a tag is optional."""
    assert isinstance(find_tag(), str)
    head, now = measure(read_tag("HEAD")), measure(read_tree())
    assert set(head) == set(now)

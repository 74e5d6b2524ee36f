"""Build arguments are part of what podman's cache compares."""

from __future__ import annotations

import pytest

from rigel_build.engine import mark, pass_on

DIGEST = "d4735e3a265e"  # of "2"


def test_each_value_that_is_given_is_marked() -> None:
    """Behind its ARG, in every stage; what stands before the first FROM is no stage's."""
    text = "ARG V=1\nFROM a\nARG V=1\nENV V=${V}\nFROM b\narg W\nRUN true"
    assert mark(text, {"V": "2"}) == (
        "ARG V=1\nFROM a\nARG V=1\n"
        f'LABEL rigel-k8s.build-arg.V="{DIGEST}"\n'
        "ENV V=${V}\nFROM b\narg W\nRUN true\n"
    )


def test_an_argument_at_the_end_of_the_file() -> None:
    """With or without a last line end."""
    assert mark("FROM a\nARG V", {"V": "2"}).splitlines() == [
        "FROM a",
        "ARG V",
        f'LABEL rigel-k8s.build-arg.V="{DIGEST}"',
    ]


@pytest.mark.parametrize(
    "text", ["FROM a\nRUN echo \\\n  ARG V\n", "FROM a\n# ARG V\n", "FROM a\nARG V2\n", "ARG V\n"]
)
def test_all_else_stays_as_it_is(text: str) -> None:
    """A continued line, a comment, another name."""
    assert mark(text, {"V": "2"}) == text


def test_the_value_itself_is_not_written() -> None:
    """It may be a secret."""
    assert "hunter2" not in mark("FROM a\nARG PASSWORD\n", {"PASSWORD": "hunter2"})


def test_values_are_in_the_environment_and_not_among_the_words() -> None:
    """Other users of the machine see the words; a name that is taken keeps its value there."""
    words, env = pass_on(
        {"TOKEN": "planted", "PATH": "/own", "LANG": "C"}, {"PATH": "/", "LANG": "C"}
    )
    assert words == ["--build-arg", "TOKEN", "--build-arg", "PATH=/own", "--build-arg", "LANG"]
    assert env == {"TOKEN": "planted", "PATH": "/", "LANG": "C"}

"""`rigel explain` has what docs/errors.md has, in a terminal."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from rigel_k8s.cli import main
from rigel_k8s.commands.explain import explain, list_kinds
from rigel_k8s.errors import UserError

PAGE = (Path(__file__).parents[3] / "docs/errors.md").read_text("utf-8")


def test_every_kind_of_the_page_is_explained() -> None:
    """The page is generated from the code; exit codes are no kinds."""
    rows = set(re.findall(r"^\| `([A-Za-z][\w-]*)` \|", PAGE, re.MULTILINE))
    assert len(rows) > 30
    assert rows == {one.kind for one in list_kinds()}


def test_texts_have_no_markdown_links() -> None:
    """A terminal cannot follow them, and a user of the package has no docs/."""
    texts = [one.cause + one.remedy + one.found_by for one in list_kinds()]
    assert not [text for text in texts if "](" in text or ".md" in text]
    assert explain("orphan")[0].remedy.endswith("roscore gets its registrations back")


def test_brackets_may_be_copied_along() -> None:
    """As the kind stands behind a message."""
    assert explain("[mtu]") == explain("mtu")
    assert explain("mtu")[0].found_by == "`/sys/class/net/NAME/mtu`"


def test_an_unknown_kind_names_the_nearest() -> None:
    """So a typing error costs one look."""
    with pytest.raises(UserError, match='no explanation of "crahs", did you mean "crash"'):
        explain("crahs")


def test_a_kind_that_its_message_explains_is_no_mistake() -> None:
    """Most kinds have no entry, and the answer says where to look."""
    with pytest.raises(UserError, match=r'no explanation of "unknown-key"$') as raised:
        explain("unknown-key")
    assert "the message before a word in brackets" in str(raised.value.hint)


def test_a_word_of_kubectl_is_explained() -> None:
    """What `kubectl get pods` shows is explained although no message of ours has it."""
    (word,) = explain("CrashLoopBackOff")
    assert "rigel logs" in word.remedy


def test_all_words_are_listed_with_what_they_mean(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["explain"], "rigel") == 0
    lines = capsys.readouterr().out.splitlines()
    assert "  crash: the container ends again and again" in lines
    assert sum(line.startswith("  ") for line in lines) == len(list_kinds())

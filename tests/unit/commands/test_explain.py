"""`rigel explain` has what docs/errors.md has, in a terminal."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from rigel_k8s.commands.explain import explain, list_kinds
from rigel_k8s.errors import UserError

PAGE = (Path(__file__).parents[3] / "docs/errors.md").read_text("utf-8")


def test_every_kind_of_the_page_is_explained() -> None:
    """The page is generated from the code; exit codes are no kinds."""
    rows = set(re.findall(r"^\| `([A-Za-z][\w-]*)` \|", PAGE, re.MULTILINE))
    assert len(rows) > 100
    assert rows == {one.kind for one in list_kinds()}


def test_texts_have_no_markdown_links() -> None:
    """A terminal cannot follow them, and a user of the package has no docs/."""
    texts = [one.cause + one.remedy for one in list_kinds()]
    assert not [text for text in texts if "](" in text or ".md" in text]
    assert explain("unknown-key")[0].remedy.endswith(" and `rigel schema` all")


def test_brackets_may_be_copied_along() -> None:
    """As the kind stands behind a message."""
    assert explain("[unknown-key]") == explain("unknown-key")


def test_an_unknown_kind_names_the_nearest() -> None:
    """So a typing error costs one look."""
    with pytest.raises(UserError, match='unknown kind "unknwon-key", did you mean "unknown-key"'):
        explain("unknwon-key")


def test_a_word_of_kubectl_is_explained() -> None:
    """What `kubectl get pods` shows is explained although no message of ours has it."""
    (found,) = explain("CrashLoopBackOff")
    assert "rigel logs" in found.remedy

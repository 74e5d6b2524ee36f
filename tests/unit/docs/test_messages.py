"""What the program prints or writes names no page of docs/: a package has none.

The remedy stands in the message, or `rigel explain` prints it.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[3] / "src"
#: A page, but not the target of a link, which the generated pages have and `explain` removes.
PAGE = re.compile(r"(?<!\]\()(?<![\w/-])[\w/-]+\.md\b")


def find_pages(code: str) -> Iterator[str]:
    """Yield each page that a text of a program names, with its line; docstrings may name pages."""
    tree = ast.parse(code)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
        if is_text and id(node) not in docstrings:
            yield from (f"{node.lineno}: {page}" for page in PAGE.findall(node.value))


def test_no_text_names_a_page() -> None:
    """Messages, hints, help, and the Rigelfiles that `rigel init` writes."""
    files = sorted(SOURCES.rglob("*.py"))
    assert len(files) > 400
    found = [
        f"{file.relative_to(SOURCES)}:{page}"
        for file in files
        for page in find_pages(file.read_text("utf-8"))
    ]
    assert found == []


@pytest.mark.parametrize(
    "code",
    [
        'HINT = "see docs/images.md"',
        'f"{fault} (networking.md)"',
        'print("""\\\n# https://site.example/docs/security.md#limits\n""")',
    ],
)
def test_a_page_is_found(code: str) -> None:
    """In plain texts, those with values in them, and those of several lines."""
    assert len(list(find_pages(code))) == 1


@pytest.mark.parametrize(
    "code",
    ['"""As docs/images.md says."""', '"set [`network`](networking.md)"', "# docs/discovery.md"],
)
def test_words_for_developers_are_not(code: str) -> None:
    """A docstring, a comment, and a link of the generated pages."""
    assert list(find_pages(code)) == []

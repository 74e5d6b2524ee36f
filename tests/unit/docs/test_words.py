"""The documentation avoids the words of STYLE.md that no reader expects."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
#: Made from the words of the code.
OTHERS = {}
PAGES = [
    *(page for page in sorted(DOCS.rglob("*.md")) if page.name not in OTHERS),
    *(
        ROOT / name
        for name in (
            "README.md",
            "CONTRIBUTING.md",
            "CHANGELOG.md",
            "examples/observability/README.md",
        )
    ),
]
AVOIDED = re.compile(
    r"\b(told|tells|nobody|somebody|everybody|whoever|anew|shall|knows no|there is none"
    r"|cannot be had|for want of|unless told)\b",
    re.IGNORECASE,
)


def find_avoided(text: str) -> list[str]:
    """Return the lines of a page with such a word; code and tables of users are not prose."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    prose = re.sub(r"`[^`\n]*`", "", prose).replace("nobody (65534)", "")
    return [line for line in prose.splitlines() if AVOIDED.search(line)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_avoids_them(page: Path) -> None:
    """STYLE.md has what to write instead."""
    assert find_avoided(page.read_text("utf-8")) == []


def test_a_word_is_found() -> None:
    """In prose, not in code."""
    assert find_avoided("A lost node is\ntold `nobody`.\n```\nshall\n```\n") == ["told ."]

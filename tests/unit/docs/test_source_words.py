"""Code, its comments and its messages avoid the words of STYLE.md that no reader expects."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from .test_words import AVOIDED

ROOT = Path(__file__).parents[3]
PROGRAMS = ("src/rigel_lab", "tools", "bench", "examples")
#: Folders of compiled modules, and of the library of `rigel ui`'s page.
NOT_OURS = {"__pycache__", "lib"}
#: Words that are wrong in names, too: `def told`. "tell apart" is what an engineer says.
TELL = r"told|tells?(?! apart)"
#: The words of the documentation and `tell`, also as a part of a name (`is_told`, `NOT_TOLD`), and
#: phrases that go on in the next line of a comment or of a text in quotes.
IN_CODE = re.compile(
    rf"(?<![a-z])(?:{AVOIDED.pattern.replace(chr(92) + 'b', '')}|{TELL})(?![a-z])".replace(
        " ", r"[ \n#:\"']+"
    ),
    re.IGNORECASE,
)


def list_packages() -> list[Path]:
    """Return the folders and modules of the product, each of which is one test."""
    product = [path for path in (ROOT / "src/rigel_k8s").iterdir() if path.name != "__pycache__"]
    return sorted([*product, *(ROOT / name for name in PROGRAMS)])


def find_avoided(text: str) -> Iterator[str]:
    """Yield the line of each avoided word, with its number."""
    lines = text.splitlines()
    for found in IN_CODE.finditer(text.replace('"nobody"', '"      "')):  # the user of Unix
        number = text.count("\n", 0, found.start()) + 1
        yield f"{number}: {lines[number - 1].strip()}"


def read_text(file: Path) -> str:
    """Return a file's text, which a picture or a compiled module does not have."""
    try:
        return file.read_text("utf-8")
    except UnicodeDecodeError:
        return ""


@pytest.mark.parametrize("package", list_packages(), ids=lambda path: path.name)
def test_a_package_avoids_them(package: Path) -> None:
    """STYLE.md has what to write instead."""
    files = sorted(package.rglob("*")) if package.is_dir() else [package]
    found = [
        f"{file.relative_to(ROOT)}:{line}"
        for file in files
        if file.is_file() and not NOT_OURS & set(file.parts)
        for line in find_avoided(read_text(file))
    ]
    assert found == []


@pytest.mark.parametrize(
    "text",
    [
        "#: As the pod is told.",
        "def is_told() -> bool:",
        'NOT_TOLD = "-"',
        "tell(findings)",
        "# Where there is\n# none.",
        '"it knows"\n    " no such image"',
        "for_whoever = 1",
    ],
)
def test_a_word_is_found(text: str) -> None:
    """In comments, names and texts, also over the end of a line."""
    assert len(list(find_avoided(text))) == 1


@pytest.mark.parametrize("text", ['USER = "nobody"', "how to tell apart two pods", "Intelligent"])
def test_an_engineers_word_is_not(text: str) -> None:
    """Parts of other words, the user of Unix, and the one use of `tell` that is plain."""
    assert list(find_avoided(text)) == []

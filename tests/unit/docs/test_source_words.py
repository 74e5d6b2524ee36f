"""Code, its comments and its messages avoid the words of STYLE.md that no reader expects."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from .test_words import AVOIDED

ROOT = Path(__file__).parents[3]
SUFFIXES = {".py", ".sh", ".yaml", ".yml", ".json", ".md", ".toml", ".txt"}
#: In names, too: `def told`. "tell apart" is good English, and "nobody" a user's name.
IN_CODE = re.compile(
    rf"{AVOIDED.pattern}|(?<![a-z])(told|tells?(?! apart))(?![a-z])", re.IGNORECASE
)


def list_packages() -> list[Path]:
    """Return the folders and modules of the product, each of which is one test."""
    product = [path for path in (ROOT / "src/rigel_k8s").iterdir() if path.name != "__pycache__"]
    return sorted(
        [*product, *(ROOT / name for name in ("src/rigel_lab", "tools", "bench", "examples"))]
    )


@pytest.mark.parametrize("package", list_packages(), ids=lambda path: path.name)
def test_a_package_avoids_them(package: Path) -> None:
    """STYLE.md has what to write instead."""
    files = sorted(package.rglob("*")) if package.is_dir() else [package]
    found = [
        f"{file.relative_to(ROOT)}:{number}: {line.strip()}"
        for file in files
        if file.suffix in SUFFIXES and "__pycache__" not in file.parts
        for number, line in enumerate(file.read_text("utf-8").splitlines(), 1)
        if IN_CODE.search(line.replace('"nobody"', ""))
    ]
    assert found == []

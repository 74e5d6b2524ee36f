"""docs/architecture.md: its picture is that of the code, and its paths are there."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from tools.architecture import PICTURE, WORDS, layers, picture

if sys.version_info >= (3, 11):
    import tomllib
else:  # a dependency of pytest
    import tomli as tomllib

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text("utf-8")


def test_the_picture_shows_the_code_as_it_is() -> None:
    """Otherwise run `python -m tools.architecture`."""
    assert PICTURE.read_text("utf-8") == picture()


def test_nothing_is_cut_off_at_the_edges() -> None:
    """Not even the widest layer."""
    _, _, width, height = map(float, re.findall(r'svg" viewBox="([^"]*)"', picture())[0].split())
    boxes = re.findall(r'<rect x="(\S+)" y="(\S+)" width="(\S+)" height="(\S+)"', picture())
    assert boxes
    for x, y, wide, high in (map(float, box) for box in boxes):
        assert 0 < x < x + wide < width
        assert 0 < y < y + high < height


def test_each_package_is_in_the_picture_and_on_the_page() -> None:
    """A new package has a layer, words and a place in a sentence or a row."""
    homes = (ROOT / "src" / "rigel_k8s", ROOT / "src")
    there = {path.name for home in homes for path in home.iterdir() if path.is_dir()}
    there = {name for name in there if not name.startswith("_")} - {"rigel_k8s"}
    assert there == set(WORDS) == {name for row in layers() for name in row}
    assert there <= set(re.findall(r"`(\w+)/?`", PAGE))


def test_each_house_is_checked_by_lint() -> None:
    """By mypy and import-linter, with a limit of lines; and it is in the wheel."""
    houses = {path.name for path in (ROOT / "src").iterdir() if path.is_dir()}
    tool = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]
    assert houses == set(tool["mypy"]["packages"])
    assert houses == set(tool["importlinter"]["root_packages"])
    assert houses <= set(tool["rigel"]["budget"])
    wheel = tool["hatch"]["build"]["targets"]["wheel"]["packages"]
    assert {f"src/{house}" for house in houses} == set(wheel)


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`([a-z_0-9]+/[a-z_/0-9.]*)`", PAGE))))
def test_paths_of_the_page_are_there(path: str) -> None:
    """A path is one of the package, or of the repository."""
    homes = (ROOT / "src" / "rigel_k8s", ROOT / "src", ROOT)
    assert any((home / path).exists() for home in homes), path

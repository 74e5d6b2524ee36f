"""The documentation site builds without a warning, and loads nothing from elsewhere."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.programs

pytest.importorskip("mkdocs")

ROOT = Path(__file__).parents[3]
#: What a page fetches by itself; links (`<a>`) it does not.
FETCHED = re.compile(r'<(?:script|link|img|iframe|source)\b[^>]*\b(?:src|href)="?([^" >]+)')


def build(project: Path, target: Path) -> subprocess.CompletedProcess[str]:
    """Build a site as `./run docs` does."""
    return subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", target],
        cwd=project,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=300,
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly."""
    target = tmp_path_factory.mktemp("site")
    done = build(ROOT, target)
    assert done.returncode == 0, done.stdout
    return target


def test_pages_load_nothing_from_elsewhere(site: Path) -> None:
    """No fonts, scripts, styles or pictures of other servers: the site works without internet."""
    pages = list(site.rglob("*.html"))
    assert len(pages) > 40
    fetched = {address for page in pages for address in FETCHED.findall(page.read_text("utf-8"))}
    assert len(fetched) > 5
    canonical = {address for address in fetched if address.startswith(("http:", "https:", "//"))}
    assert canonical == set()
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(https?:)?//", style.read_text("utf-8")), style


def test_the_search_finds_every_page(site: Path) -> None:
    """Its index is part of the site."""
    index = json.loads((site / "search" / "search_index.json").read_text("utf-8"))
    found = {entry["location"].partition("#")[0] for entry in index["docs"]}
    pages = {str(page.parent.relative_to(site)) for page in site.rglob("index.html")}
    assert {location.rstrip("/") or "." for location in found} == pages


@pytest.mark.parametrize(
    ("words", "page"),
    [
        ("rosbag", "placement/"),
        ("rosbag", "whole-robot/"),
        ("gpu", "nodes/"),
        ("udev", "placement/"),
        ("foxglove", "see/"),
        ("docker compose", ""),
    ],
)
def test_the_search_finds_words_in_text_and_code(site: Path, words: str, page: str) -> None:
    """Also between brackets, dots and slashes: [rosbag, record], nvidia.com/gpu."""
    index = json.loads((site / "search" / "search_index.json").read_text("utf-8"))
    separator = re.compile(index["config"]["separator"])
    found: dict[str, set[str]] = {}
    for entry in index["docs"]:
        tokens = separator.split(f"{entry['title']} {entry['text']}".lower())
        found.setdefault(entry["location"].partition("#")[0], set()).update(tokens)
    assert set(words.split()) <= found[page]


def test_bars_in_tables_have_no_backslash(site: Path) -> None:
    """GitHub needs one in a table's code."""
    page = (site / "cli" / "index.html").read_text("utf-8")
    assert "<code>init [--ros 1|2|DISTRO] [--force]</code>" in page
    assert [page for page in site.rglob("*.html") if "\\|" in page.read_text("utf-8")] == []


def test_only_the_tables_of_options_have_their_class(site: Path) -> None:
    """Where a screen is narrow, their cells are below each other; others would lose their heads."""
    css = (site / "site.css").read_text("utf-8")
    assert ".options table" in css
    with_class = [p for p in site.rglob("*.html") if 'class="options"' in p.read_text("utf-8")]
    assert with_class == [site / "reference/index.html"]


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A project with this one's configuration and a single page."""
    (tmp_path / "docs").mkdir()
    (tmp_path / "tools").mkdir()
    shutil.copy(ROOT / "tools" / "site.py", tmp_path / "tools")
    shutil.copy(ROOT / "docs" / "site.css", tmp_path / "docs")
    settings = (ROOT / "mkdocs.yml").read_text("utf-8").partition("\nnav:")[0]
    (tmp_path / "mkdocs.yml").write_text(f"{settings}\nnav: [index.md]\n")
    (tmp_path / "docs" / "index.md").write_text("# Here\n\n[Here](index.md#here)\n")
    return tmp_path


def test_a_small_site_builds(small: Path) -> None:
    """The next tests change one thing each."""
    done = build(small, small / "site")
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize(
    ("text", "word"),
    [("[x](nowhere.md)", "nowhere.md"), ("[x](#nowhere)", "#nowhere")],
)
def test_a_dead_link_fails_the_build(small: Path, text: str, word: str) -> None:
    """To a page, and to a place in a page."""
    with (small / "docs" / "index.md").open("a") as page:
        page.write(text)
    done = build(small, small / "site")
    assert done.returncode != 0
    assert word in done.stdout


def test_a_page_that_no_menu_shows_fails_the_build(small: Path) -> None:
    """A new page gets its place in mkdocs.yml."""
    (small / "docs" / "orphan.md").write_text("# Orphan\n")
    done = build(small, small / "site")
    assert done.returncode != 0
    assert "orphan.md" in done.stdout

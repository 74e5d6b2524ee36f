"""A hook of MkDocs (mkdocs.yml): links and tables that work on GitHub also work on the site.

A page links to a file of the repository by its relative path. The site has only docs/, so such a
link becomes one to the file on GitHub. In the code of
a table, GitHub needs `\\|` for a bar; the site would show the backslash. The page of options gets a
class, by which docs/site.css shows a table's cells below each other on a narrow screen.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from mkdocs.structure.pages import Page

ROOT = Path(__file__).parents[1]
GITHUB = "https://github.com/rigel-k8s/rigel-k8s/blob/main"
LINK = re.compile(r"\[([^]]*)\]\(([^)\s]+)\)")
OPTIONS = "reference.md"
ROW = re.compile(r"^\|.*", re.MULTILINE)
CODE = re.compile(r"`[^`]*`")


def on_page_markdown(markdown: str, *, page: Page, config: Any, files: Any) -> str:
    """Return a page for the site: its links out of docs/ and its tables' bars replaced."""

    def replace(found: re.Match[str]) -> str:
        text, link = found.groups()
        path = find_outside(Path(page.file.abs_src_path or ""), link, Path(config.docs_dir))
        return found[0] if path is None else f"[{text}]({GITHUB}/{path})"

    return ROW.sub(show_bars, LINK.sub(replace, markdown))


def on_page_content(html: str, *, page: Page, config: Any, files: Any) -> str:
    """Return a page's HTML, in an element with a class if its tables are those of options."""
    return f'<div class="options">{html}</div>' if page.file.src_uri == OPTIONS else html


def show_bars(row: re.Match[str]) -> str:
    """Return a table's row whose code has bars without backslashes."""
    return CODE.sub(lambda code: code[0].replace("\\|", "|"), row[0])


def find_outside(page: Path, link: str, docs: Path) -> Path | None:
    """Return the repository's file that a link names, or None if the link stays in docs/."""
    parts = urlsplit(link)
    if parts.scheme or not parts.path:
        return None
    target = (page.parent / parts.path).resolve()
    if target.is_relative_to(docs.resolve()) or not target.is_relative_to(ROOT):
        return None
    return target.relative_to(ROOT) if target.exists() else None

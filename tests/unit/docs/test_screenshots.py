"""The pictures of the site that are in docs/pictures."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.screenshots.views import PICTURES, VIEWS, View

DOCS = Path(__file__).parents[3] / "docs"


@pytest.mark.parametrize("view", VIEWS, ids=lambda view: view.file)
def test_a_picture_shows_a_page_that_exists_and_is_small(view: View) -> None:
    """Otherwise run `python -m tools.screenshots`; a page without a name is the first one."""
    page = view.page.removesuffix("/") or "index"
    assert (DOCS / f"{page}.md").is_file()
    assert 5_000 < (PICTURES / view.file).stat().st_size < 150_000


def test_no_picture_is_left_over() -> None:
    """One that is not in the list would never be taken again."""
    assert {file.name for file in PICTURES.glob("site-*")} == {view.file for view in VIEWS}

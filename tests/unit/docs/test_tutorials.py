"""A reader without a cluster can follow the tutorials (tests/support/tutorials.py)."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.tutorials import FOLDER, REASON, RIGEL, follow, make_place, read_blocks

PAGES = sorted(FOLDER.glob("*.md"))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory of a reader who has `rigel` and no cluster."""
    monkeypatch.setenv("KUBECONFIG", str(tmp_path / "no-kubeconfig"))
    return make_place(tmp_path, {"rigel": RIGEL})


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_can_be_followed(page: Path, place: Path) -> None:
    """Its Rigelfiles pass the check, and its commands do what it says."""
    assert list(follow(page.read_text("utf-8"), place)) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_blocks_are_of_a_kind_that_is_run(page: Path) -> None:
    """No block is overlooked because its language or its comment is written differently."""
    text = page.read_text("utf-8")
    blocks = read_blocks(text)
    assert text.count("\n```") == 2 * len(blocks)
    for block in blocks:
        assert block.language in ("yaml", "shell", "text"), block
        assert block.language != "yaml" or block.title, block
        assert not block.comment or REASON.fullmatch(block.comment), block


@pytest.mark.parametrize(
    "page",
    [
        "```shell\nfalse\n```\n",
        "```shell\necho one\n```\n\n```text\ntwo\n```\n",
        '```yaml title="Rigelfile"\nnodes: {}\n```\n',
    ],
)
def test_a_wrong_page_is_noticed(page: str, place: Path) -> None:
    """A command that fails, prints something else, or a Rigelfile with a problem."""
    assert len(list(follow(page, place))) == 1


def test_a_block_with_a_reason_is_not_run(place: Path) -> None:
    """And neither is its output compared."""
    page = "<!-- not run: it needs a cluster -->\n```shell\nfalse\n```\n\n```text\nx\n```\n"
    assert list(follow(page, place)) == []
    assert len(list(follow(page, place, cluster=True))) == 2

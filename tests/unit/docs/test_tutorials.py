"""A reader without a cluster can follow the tutorials (tests/support/tutorials.py)."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.support.tutorials import (
    FOLDER,
    RIGEL,
    find_overlooked,
    follow,
    make_place,
    read_blocks,
)

PAGES = sorted(FOLDER.glob("*.md"))


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory of a reader who has `rigel` and no cluster."""
    monkeypatch.setenv("KUBECONFIG", str(tmp_path / "no-kubeconfig"))
    return make_place(tmp_path, {"rigel": RIGEL})


@pytest.mark.programs
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_can_be_followed(page: Path, place: Path) -> None:
    """Its Rigelfiles pass the check, and its commands do what it says."""
    assert list(follow(page.read_text("utf-8"), place)) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_blocks_are_of_a_kind_that_is_run(page: Path) -> None:
    """No block is overlooked because it is written differently."""
    assert read_blocks(page.read_text("utf-8"))
    assert list(find_overlooked(page.read_text("utf-8"))) == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_revisions_have_one_time_each(page: Path) -> None:
    """The histories of a page agree, and a revision is younger than the one before."""
    rows = re.findall(r"^(\d+) +\w+ +(\d{4}-\S+Z) ", page.read_text("utf-8"), re.M)
    times = sorted({(int(number), time) for number, time in rows})
    assert [number for number, _ in times] == list(range(1, len(times) + 1))
    moments = [time for _, time in times]
    assert moments == sorted(set(moments))


def test_the_tutorial_about_k3s_has_only_blocks_that_are_run() -> None:
    """tests/cluster/network/test_k3s_guide.py runs its commands, with its Rigelfile."""
    text = (FOLDER.parent / "k3s.md").read_text("utf-8")
    blocks = read_blocks(text)
    assert [block.language for block in blocks].count("yaml") == 1
    assert {block.language for block in blocks} == {"console", "yaml"}
    assert not any("not read" in line for line in find_overlooked(text))


OVERLOOKED = {
    "bash": "```bash\ntrue\n```\n",
    "no language": "```\ntrue\n```\n",
    "console": "```console\n$ true\n```\n",
    "a file without a name": "```yaml\na: 1\n```\n",
    "in a list": "- One:\n\n  ```shell\n  true\n  ```\n",
    "tildes": "~~~shell\ntrue\n~~~\n",
    "four spaces": "Run:\n\n    rigel check\n",
    "no reason": "<!-- skipped -->\n```shell\ntrue\n```\n",
    "an empty reason": "<!-- not run: -->\n```shell\ntrue\n```\n",
    "output of nothing": "```text\nready\n```\n",
}


@pytest.mark.parametrize("page", OVERLOOKED.values(), ids=OVERLOOKED)
def test_a_block_that_is_neither_run_nor_marked_is_noticed(page: str) -> None:
    """Once each, or for its beginning and its end."""
    assert len(list(find_overlooked(f"# A page\n\n{page}"))) in (1, 2)


def test_a_page_of_blocks_that_are_run_or_marked_is_fine() -> None:
    """The forms that the pages use."""
    page = (
        '```yaml title="a.yaml"\na: 1\n```\n\n<!-- not run: it needs a cluster -->\n'
        "```shell\nrigel status\n```\n\n```text\nready\n```\n"
    )
    assert list(find_overlooked(page)) == []


@pytest.mark.programs
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


@pytest.mark.programs
def test_a_block_with_a_reason_is_not_run(place: Path) -> None:
    """And neither is its output compared."""
    page = "<!-- not run: it needs a cluster -->\n```shell\nfalse\n```\n\n```text\nx\n```\n"
    assert list(follow(page, place)) == []
    assert len(list(follow(page, place, cluster=True))) == 2

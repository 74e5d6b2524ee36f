"""A directory is written whole, or not at all."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rigel_k8s.errors import UserError
from rigel_k8s.system.trees import Directory, File, Link, write_tree


def test_a_tree_is_written_as_it_is(tmp_path: Path) -> None:
    """Files with their right to execute, links, empty directories, missing parents."""
    tree = {
        "link": Link("src/a.py"),
        "src/a.py": File(b"x", executable=True),
        "src/b": File(b"y"),
        "empty": Directory(),
    }
    target = tmp_path / "far" / "out"
    write_tree(tree, target)
    assert sorted(path.name for path in target.rglob("*")) == [
        *("a.py", "b", "empty", "link", "src"),
    ]
    assert (target / "link").read_bytes() == b"x"
    assert os.access(target / "src/a.py", os.X_OK)
    assert not os.access(target / "src/b", os.X_OK)
    assert target.stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize("tree", [{"a": File(b""), "a/b": File(b"")}, {"a" * 300: File(b"")}])
def test_nothing_is_left_of_a_tree_that_cannot_be_written(
    tree: dict[str, File], tmp_path: Path
) -> None:
    """Its parent stays empty."""
    with pytest.raises(UserError, match="cannot be written"):
        write_tree(tree, tmp_path / "out")
    assert not any(tmp_path.iterdir())


def test_what_is_there_is_kept(tmp_path: Path) -> None:
    """A file, a directory that is not empty, and a link to an empty one."""
    (tmp_path / "file").write_text("x")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "a").touch()
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("empty")
    for name in ("file", "full", "link"):
        with pytest.raises(UserError, match="already exists"):
            write_tree({"b": File(b"")}, tmp_path / name)
    assert sorted(path.name for path in tmp_path.rglob("*")) == [
        *("a", "empty", "file", "full", "link")
    ]

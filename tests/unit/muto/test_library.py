"""Stacks are found by their ids in the files of one directory, and not beyond its limits."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from rigel_muto import opening
from rigel_muto.opening import Library, NotFound, open_stack


def write(directory: Path, name: str, identifier: str) -> None:
    stack = {"stackId": identifier, "node": [{"name": "a", "pkg": "p", "exec": "e"}]}
    (directory / name).write_text(json.dumps(stack))


def test_what_is_no_stack_is_passed_over(tmp_path: Path) -> None:
    """Other JSON, broken JSON, other files, pipes and directories of such a name."""
    write(tmp_path, "a.json", "org:a")
    (tmp_path / "broken.json").write_text('{"org:a"')
    (tmp_path / "other.json").write_text('["org:a"]')
    (tmp_path / "bytes.json").write_bytes(b"\xff")
    write(tmp_path, "a.txt", "org:a")
    (tmp_path / "directory.json").mkdir()
    os.mkfifo(tmp_path / "pipe.json")
    assert Library(tmp_path, tmp_path).find("org:a").ids == ("org:a",)


def test_a_stack_is_the_same_whenever_it_is_found(tmp_path: Path) -> None:
    """So one that several others refer to is deployed once."""
    write(tmp_path, "a.json", "org:a")
    found = Library(tmp_path, tmp_path)
    assert found.find("org:a") is found.find("org:a")


def test_a_directory_with_too_much_in_it_is_not_searched(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stack that is named by its file is read all the same."""
    for number in range(3):
        write(tmp_path, f"{number}.json", f"org:{number}")
    monkeypatch.setattr(opening, "MOST_FILES", 2)
    with pytest.raises(NotFound, match="more than 2 files"):
        open_stack("org:1", tmp_path, tmp_path, None)
    assert open_stack("1.json", tmp_path, tmp_path, None)[0].ids == ("org:1",)


def test_a_file_with_several_stacks_needs_an_id(tmp_path: Path) -> None:
    things = [
        {"thingId": f"org:{n}", "features": {"stack": {"properties": {"node": []}}}} for n in "ab"
    ]
    (tmp_path / "found.json").write_text(json.dumps({"items": things}))
    with pytest.raises(NotFound, match="has 2 stacks, name one by its id: org:a, org:b"):
        open_stack("found.json", tmp_path, tmp_path, None)
    assert open_stack("org:b", tmp_path, tmp_path, None)[0].ids == ("org:b",)

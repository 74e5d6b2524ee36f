"""What the test of planted secrets would find: each kind of leak, made on purpose."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.planted import find, find_left, tracing
from tests.support.until import until

SECRET = "planted-for-this-test"


def encode(text: str) -> str:
    return base64.b64encode(text.encode()).decode()


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (f"password: {SECRET}", True),
        (f"data: {encode(SECRET)}", True),
        (f"Authorization: Basic {encode(f'me:{SECRET}')}", True),
        ("password: ***", False),
    ],
)
def test_a_text_is_searched_for_all_forms(text: str, *, found: bool) -> None:
    """As it is, and as headers and Secrets have it."""
    assert bool(find([SECRET], text)) is found


@pytest.mark.programs
@pytest.mark.parametrize("place", ["arguments", "environments"])
def test_a_process_that_has_a_secret_is_seen(place: str, tmp_path: Path) -> None:
    """In its arguments, or in an environment that is not this process' own."""
    words = [sys.executable, "-c", "input()", *([SECRET] if place == "arguments" else [])]
    env = {**os.environ, **({"TOKEN": SECRET} if place == "environments" else {})}
    process = subprocess.Popen(words, env=env, stdin=subprocess.PIPE)
    try:
        with tracing(tmp_path, [SECRET]) as trace:
            until(
                lambda: any(SECRET in line for line in getattr(trace, place).copy()),
                f"{place} with the secret",
            )
    finally:
        process.communicate(b"\n")


@pytest.mark.parametrize(
    ("file", "directory", "seen"),
    [(0o644, 0o755, True), (0o600, 0o755, False), (0o644, 0o700, False)],
)
def test_an_open_file_is_seen_although_it_goes(
    file: int, directory: int, tmp_path: Path, *, seen: bool
) -> None:
    """One that only its owner can read, or in such a directory, exposes nothing."""
    (tmp_path / "made").mkdir()
    (tmp_path / "made").chmod(directory)
    with tracing(tmp_path, [SECRET]) as trace:
        made = tmp_path / "made" / "file"
        made.touch()
        made.chmod(file)
        made.write_text(f"key: {SECRET}")
        looks = trace.looks
        until(lambda: trace.looks > looks + 1, "another look")
        made.unlink()
    assert bool(trace.exposed) is seen
    assert find_left(tmp_path, [SECRET]) == []


def test_a_file_that_stays_is_found(tmp_path: Path) -> None:
    """Whoever may read it."""
    (tmp_path / "log").write_text(f"key: {SECRET}")
    (tmp_path / "log").chmod(0o600)
    assert find_left(tmp_path, [SECRET]) == [str(tmp_path / "log")]

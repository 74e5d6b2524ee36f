"""bench.fuzz: a small fixed set of mutated Rigelfiles, and how it makes a finding smaller."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from bench.fuzz.__main__ import minimize
from bench.fuzz.mutation import mutate, seeds

FILES = 60


def test_a_fixed_set_of_mutated_rigelfiles_ends_without_a_finding(tmp_path: Path) -> None:
    """No traceback, and no exit code other than 0 and 2."""
    command = [sys.executable, "-m", "bench.fuzz", "--seed", "1", "--runs", str(FILES)]
    root = Path(__file__).parents[3]
    ended = subprocess.run(
        [*command, "--to", str(tmp_path)], capture_output=True, text=True, cwd=root
    )
    assert "exit code" not in ended.stdout, ended.stdout
    assert f"{FILES} files, " in ended.stdout, ended.stderr


def test_the_same_seed_gives_the_same_file() -> None:
    """Otherwise a finding could not be seen again; other seeds give other files."""
    texts = seeds()
    assert mutate(texts, "1/7") == mutate(texts, "1/7")
    assert len({mutate(texts, f"1/{number}") for number in range(50)}) > 40


def test_a_finding_keeps_only_the_lines_that_it_needs() -> None:
    """Two lines that fail only together are kept, the others are left out."""
    content = b"a\nbad\nb\nc\nworse\nd\n"
    assert minimize(content, lambda part: b"bad\n" in part and b"worse\n" in part) == (
        b"bad\nworse\n"
    )

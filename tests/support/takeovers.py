"""Whether a new talker of a demo had begun before the old one fell silent."""

from __future__ import annotations

import itertools
import re
import subprocess
import sys
from datetime import datetime
from pathlib import Path

_STAMP = r"^(\S+?)\.(\d+)Z "


def _time(stamp: re.Match[str]) -> float:
    return datetime.fromisoformat(stamp[1]).timestamp() + float(f"0.{stamp[2]}")


def assert_took_over(heard: str, said: str, word: str = "hello world") -> None:
    """Check that the listener heard the old talker until the new one had started.

    Args:
        heard: `rigel logs listener --timestamps`. Each talker numbers its greetings from 1.
        said: the same of the new talker.
        word: what greetings of this talker begin with.
    """
    lines = re.finditer(rf"{_STAMP}.*I heard {re.escape(word)}\S* \S+ (\d+)$", heard, re.M)
    greetings = [(_time(line), int(line[3])) for line in lines]
    last = [one[0] for one, next_ in itertools.pairwise(greetings) if next_[1] < one[1]]
    begun = re.search(rf"{_STAMP}.*talker version 2$", said, re.M)
    assert begun is not None, said
    assert last, "the listener heard no new talker"
    assert _time(begun) < last[-1], "the old talker fell silent before the new one began"


def longest_gap(examples: Path, heard: str, *words: str) -> str:
    """Return what the demo prints in the end."""
    line = [sys.executable, str(examples / "longest_gap.py"), *words]
    done = subprocess.run(line, input=heard, capture_output=True, text=True, check=True)
    return done.stdout

"""Every YAML block of the two documents about this room is a job's `with` that works."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from .shapes import problems, release

DOCS = Path(__file__).parents[3] / "docs"
FILES = {"config/planner.yaml": "speed: 1\n"}


def blocks() -> Iterator[object]:
    """Yield each block with where it stands."""
    for name in ("ros1.md", "coming-from-the-peer.md"):
        text = (DOCS / name).read_text("utf-8")
        for found in re.finditer(r"^```yaml\n(.*?)^```", text, re.M | re.S):
            line = text[: found.start()].count("\n") + 2
            yield pytest.param(found[1], id=f"{name}:{line}")


@pytest.mark.parametrize("text", list(blocks()))
def test_documented_options_work(text: str) -> None:
    """They pass the check and become objects."""
    assert [p for p in problems(text) if p.severity == "error"] == []
    assert release(text, files=FILES).objects

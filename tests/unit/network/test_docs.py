"""Every YAML block of docs/networking.md is a job's `with` that works."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..app.shapes import problems, release

PAGE = Path(__file__).parents[3] / "docs" / "networking.md"


def blocks() -> Iterator[object]:
    """Yield each block with where it stands."""
    text = PAGE.read_text("utf-8")
    for found in re.finditer(r"^```yaml\n(.*?)^```", text, re.M | re.S):
        yield pytest.param(found[1], id=f"line {text[: found.start()].count(chr(10)) + 2}")


@pytest.mark.parametrize("text", list(blocks()))
def test_documented_networks_work(text: str) -> None:
    """They pass the check without a word and become objects."""
    assert problems(text, "jazzy") == []
    kinds = {item["kind"] for item in release(text, distro="jazzy").objects}
    assert "Deployment" in kinds

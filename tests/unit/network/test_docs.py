"""Every YAML block of the pages on networks is a job's `with` that works."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from ..app.shapes import problems, release

DOCS = Path(__file__).parents[3] / "docs"
PAGES = [DOCS / "networking.md", DOCS / "network-modes.md"]


def blocks() -> Iterator[object]:
    """Yield each block with where it stands."""
    for page in PAGES:
        text = page.read_text("utf-8")
        for found in re.finditer(r"^```yaml\n(.*?)^```", text, re.M | re.S):
            line = text[: found.start()].count("\n") + 2
            yield pytest.param(found[1], id=f"{page.name}:{line}")


@pytest.mark.parametrize("text", list(blocks()))
def test_documented_networks_work(text: str) -> None:
    """They pass the check without a word and become objects."""
    assert problems(text, "jazzy") == []
    kinds = {item["kind"] for item in release(text, distro="jazzy").objects}
    assert "Deployment" in kinds

"""Every YAML block of the documents about this room is a job's `with` that works."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from .shapes import problems, release

DOCS = Path(__file__).parents[3] / "docs"
FILES = {"config/planner.yaml": "speed: 1\n"}
#: Which documents, and the distribution that they write for.
ABOUT = {
    "ros1.md": "noetic",
    "ros1-nodes.md": "noetic",
    "ros1-updates.md": "noetic",
    "placement.md": "noetic",
    "coming-from-src-plugin.md": "noetic",
    "ros2.md": "jazzy",
    "ros2-nodes.md": "jazzy",
    "ros2-updates.md": "jazzy",
    "security.md": "noetic",
}
#: Warnings that an example of ours never deserves.
SURPRISES = ("own-name", "two-at-once")


def blocks() -> Iterator[object]:
    """Yield each block with where it stands."""
    for name, distro in ABOUT.items():
        text = (DOCS / name).read_text("utf-8")
        for found in re.finditer(r"^```yaml\n(.*?)^```", text, re.M | re.S):
            line = text[: found.start()].count("\n") + 2
            yield pytest.param(found[1], distro, id=f"{name}:{line}")


@pytest.mark.parametrize(("text", "distro"), list(blocks()))
def test_documented_options_work(text: str, distro: str) -> None:
    """They pass the check, become objects, and have the names and updates that they seem to."""
    found = problems(text, distro)
    assert [p for p in found if p.severity == "error" or p.kind in SURPRISES] == []
    assert release(text, distro=distro, files=FILES).objects

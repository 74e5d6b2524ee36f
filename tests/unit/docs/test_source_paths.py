"""Comments and docstrings name files that are there."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
NAMED = re.compile(r"(?<![\w./-])(?:\w+/)+\w+\.(?:py|sh|c|md)\b")
#: Files of others: ROS 1's rosmaster, the template of Rigel's plugins.
FOREIGN = {"rosmaster/paramserver.py", "rosmaster/registrations.py", "src/plugin.py"}


def test_files_that_the_source_names_are_there() -> None:
    """From the root, from src/, or from a package above."""
    known = {
        file.relative_to(ROOT)
        for top in ("src", "docs", "tests", "tools")
        for file in (ROOT / top).rglob("*.*")
    }
    ends = {"/".join(path.parts[at:]) for path in known for at in range(len(path.parts))}
    ends |= FOREIGN
    missing = [
        f"{file.relative_to(ROOT)}: {name}"
        for file in sorted((ROOT / "src").rglob("*.py"))
        for name in NAMED.findall(file.read_text("utf-8"))
        if name not in ends
    ]
    assert missing == []

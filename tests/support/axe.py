"""axe-core, which finds what keeps people with a keyboard or a screen reader from using a page."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

from tools.npm import AXE, install

from .browser import Tab

FOLDER = Path.home() / ".cache" / "rigel-k8s" / "npm"


@functools.cache
def read_axe() -> str:
    """Return axe's program; it is fetched once, and kept."""
    install(AXE, FOLDER)
    return (FOLDER / AXE.files[0].name).read_text("utf-8")


def find_violations(tab: Tab) -> list[dict[str, Any]]:
    """Return what axe finds in a page, serious or critical: each with its rule and its places."""
    tab.read(f"{read_axe()}; true")
    found: list[dict[str, Any]] = tab.read("axe.run(document).then((found) => found.violations)")
    return [
        {"rule": one["id"], "help": one["help"], "at": [node["html"] for node in one["nodes"]]}
        for one in found
        if one["impact"] in ("serious", "critical")
    ]

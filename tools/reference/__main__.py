"""Write the generated pages: `python -m tools.reference`."""

from __future__ import annotations

from pathlib import Path

from tools.reference import PAGES

DOCS = Path(__file__).parents[2] / "docs"

if __name__ == "__main__":
    for name, write in PAGES.items():
        (DOCS / name).write_text(write(), "utf-8")

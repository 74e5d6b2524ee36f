"""usage: python -m tools.diagrams    write docs/pictures/"""

from __future__ import annotations

from pathlib import Path

from tools.diagrams.pictures import PICTURES

FOLDER = Path(__file__).parents[2] / "docs" / "pictures"

if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for name, picture in PICTURES.items():
        (FOLDER / f"{name}.svg").write_text(picture.draw(), encoding="utf-8")

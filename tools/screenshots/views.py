"""Which pages of the site are shown in docs/pictures, in which widths and colors."""

from __future__ import annotations

from pathlib import Path

import attrs

PICTURES = Path(__file__).parents[2] / "docs" / "pictures"


@attrs.frozen
class View:
    """A page as a window shows it, in CSS pixels, some seconds after it was loaded.

    `page` is its address below the site's.
    """

    file: str
    page: str
    dark: bool = False
    width: int = 1280
    height: int = 800
    seconds: float = 0


VIEWS = (
    View("site-home.webp", "", seconds=3),
    View("site-tutorial-dark.webp", "tutorials/ros1/", dark=True),
    View("site-concepts.webp", "ros1/"),
    View("site-options-narrow.webp", "reference/", width=390, height=844),
    View("site-networks-narrow-dark.webp", "networking/", dark=True, width=390, height=844),
)

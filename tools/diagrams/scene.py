"""Scenes: boxes, frames around them, and arrows between places."""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from tools.diagrams import svg


@attrs.frozen
class Box:
    """A box with a title and lines of words below it. `kind` is a class of svg.py."""

    x: int
    y: int
    width: int
    height: int
    title: str
    words: tuple[str, ...] = ()
    kind: str = ""


@attrs.frozen
class Frame:
    """A dashed frame with its name at the upper edge: a machine, a pod."""

    x: int
    y: int
    width: int
    height: int
    name: str


@attrs.frozen
class Arrow:
    """An arrow with words at a place of their own."""

    start: tuple[int, int]
    end: tuple[int, int]
    words: str = ""
    at: tuple[int, int] = (0, 0)
    kind: str = ""


@attrs.frozen
class Scene:
    """A picture: its title, its size, and its items, from back to front."""

    title: str
    width: int
    height: int
    items: tuple[Box | Frame | Arrow, ...]

    def draw(self) -> str:
        """Return it as SVG."""
        shapes = (shape for item in self.items for shape in _shapes(item))
        return svg.draw(self.title, self.width, self.height, shapes)


def _shapes(item: Box | Frame | Arrow) -> Iterator[str]:
    if isinstance(item, Arrow):
        yield svg.line(*item.start, *item.end, item.kind)
        if item.words:
            bad = "bad" if "bad" in item.kind else ""
            yield svg.text(*item.at, item.words, f"middle small {bad}".strip())
    elif isinstance(item, Frame):
        yield svg.rect(item.x, item.y, item.width, item.height, "frame")
        yield svg.text(item.x + 12, item.y + 20, item.name, "small")
    else:
        yield svg.rect(item.x, item.y, item.width, item.height, item.kind)
        middle = item.x + item.width // 2
        lines = 1 + len(item.words)
        y = item.y + (item.height - lines * svg.LINE) // 2 + 13
        yield svg.text(middle, y, item.title, "middle bold")
        for number, words in enumerate(item.words, 1):
            yield svg.text(middle, y + number * svg.LINE, words, "middle small")

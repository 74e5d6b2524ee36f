"""Sequence diagrams: messages between participants, from top to bottom."""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from tools.diagrams import svg

COLUMN, STEP, HEAD, MARGIN = 190, 46, 34, 12


@attrs.frozen
class Message:
    """An arrow between two participants, with its words above it."""

    sender: str
    receiver: str
    words: str
    dashed: bool = False


@attrs.frozen
class Note:
    """What happens at one participant."""

    place: str
    words: str


@attrs.frozen
class Sequence:
    """A diagram: its title, the participants from left to right, and the steps."""

    title: str
    participants: tuple[str, ...]
    steps: tuple[Message | Note, ...]

    def draw(self) -> str:
        """Return it as SVG."""
        width = COLUMN * len(self.participants) + 2 * MARGIN
        height = MARGIN * 2 + HEAD + STEP * (len(self.steps) + 1)
        return svg.draw(self.title, width, height, self._shapes(width, height))

    def _shapes(self, width: int, height: int) -> Iterator[str]:
        middles = {
            name: MARGIN + COLUMN * index + COLUMN // 2
            for index, name in enumerate(self.participants)
        }
        for name, x in middles.items():
            yield svg.line(x, MARGIN + HEAD, x, height - MARGIN, "life", tip=False)
            yield svg.rect(x - 75, MARGIN, 150, HEAD)
            yield svg.text(x, MARGIN + 22, name, "middle bold")
        y = MARGIN + HEAD + STEP
        for step in self.steps:
            if isinstance(step, Message):
                yield from _arrow(step, middles, y)
            else:
                yield from _note(step, middles[step.place], y, width)
            y += STEP


def _arrow(message: Message, middles: dict[str, int], y: int) -> Iterator[str]:
    start, end = middles[message.sender], middles[message.receiver]
    yield svg.line(start, y, end, y, "dashed" if message.dashed else "")
    yield svg.text((start + end) // 2, y - 7, message.words, "middle small")


def _note(note: Note, x: int, y: int, width: int) -> Iterator[str]:
    wide = 7 * len(note.words) + 20
    left = min(max(x - wide // 2, MARGIN), width - MARGIN - wide)
    yield svg.rect(left, y - 22, wide, 30, "note")
    yield svg.text(left + wide // 2, y - 2, note.words, "middle small")

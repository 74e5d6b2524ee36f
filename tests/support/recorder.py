"""The one reporter of the tests: it remembers what a user would have seen."""

from __future__ import annotations

from typing import Literal

import attrs

Kind = Literal["line", "warn", "progress"]


@attrs.define
class Recorder:
    """A reporter that remembers.

    Attributes:
        path: whose words they are: "" for the reporter itself, "/name" for its child `name`.
        entries: (path, kind, text) in the order of the words; a child adds to its parent's.
        states: what `progress` was called with: (key, state, done).
    """

    path: str = ""
    entries: list[tuple[str, Kind, str]] = attrs.field(factory=list)
    states: list[tuple[str, str, bool]] = attrs.field(factory=list)

    def line(self, text: str) -> None:
        self.entries.append((self.path, "line", text))

    def warn(self, text: str) -> None:
        self.entries.append((self.path, "warn", text))

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        self.states.append((key, state, done))
        self.entries.append((self.path, "progress", f"{key}: {state}"))

    def child(self, name: str) -> Recorder:
        return Recorder(f"{self.path}/{name}", self.entries, self.states)

    @property
    def lines(self) -> list[str]:
        """What stays on the screen, without the warnings."""
        return self.of("line")

    @property
    def warnings(self) -> list[str]:
        return self.of("warn")

    @property
    def texts(self) -> list[str]:
        """All words, whatever their kind."""
        return [text for _, _, text in self.entries]

    def of(self, kind: Kind) -> list[str]:
        """Return the words of one kind."""
        return [text for _, of, text in self.entries if of == kind]

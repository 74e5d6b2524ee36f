"""How much a Rigelfile has expanded to so far; above a limit, reading ends with an error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NoReturn

import attrs

from rigel_k8s.errors import ProblemsError
from rigel_k8s.rigelfile.findings import Finding, make_finding, render
from rigel_k8s.rigelfile.limits import (
    DEEPEST,
    LONGEST_LINE,
    LONGEST_TEXT,
    MOST_LOOKED_AT,
    MOST_TEXT,
    MOST_VALUES,
)
from rigel_k8s.rigelfile.source import Source, YamlNode

if TYPE_CHECKING:
    from rigel_k8s.rigelfile.sandbox import Budget

KIND = "too-large"


class TooLarge(ProblemsError):
    """A file that expands to more than a limit allows; it is not checked further."""

    def __init__(self, source: Source, finding: Finding) -> None:
        super().__init__(
            f"{source.name} has 1 problem",
            lambda width: [render(source, finding, width=width)],
            width=LONGEST_LINE,
        )
        self.finding = finding


@attrs.define
class Spending:
    """How much one file has expanded to."""

    source: Source
    values: int = 0
    text: int = 0
    looked_at: int = 0
    _budget: Budget | None = None

    @property
    def budget(self) -> Budget:
        """The time that expressions may still take."""
        from rigel_k8s.rigelfile.sandbox import Budget

        self._budget = self._budget or Budget()
        return self._budget

    def add_values(self, use: YamlNode, made: YamlNode) -> None:
        """Count the values that a template at `use` gives."""
        self.values += count(made, MOST_VALUES)
        if self.values > MOST_VALUES:
            self.refuse(use, f"templates make more than {MOST_VALUES} values in this file")

    def add_text(self, use: YamlNode, length: int) -> None:
        """Count the characters that templates at `use` give."""
        self.text += length
        if length > LONGEST_TEXT:
            self.refuse(use, f"templates make a text of more than {LONGEST_TEXT} characters")
        if self.text > MOST_TEXT:
            self.refuse(use, f"templates make more than {MOST_TEXT} characters in this file")

    def add_look(self, options: YamlNode) -> None:
        """Count the options of a job or provider, which are about to be checked."""
        self.looked_at += count(options, MOST_LOOKED_AT)
        if self.looked_at > MOST_LOOKED_AT:
            message = (
                f"jobs, their uses and the combinations of matrices make more than"
                f" {MOST_LOOKED_AT} values to check: split this file"
            )
            self.refuse(options, message)

    def refuse(self, node: YamlNode, message: str) -> NoReturn:
        """End the check of this file, with one error at a node."""
        raise TooLarge(self.source, make_finding(node, message, KIND))


def count(node: YamlNode, most: int) -> int:
    """Return how many values a node has; counting stops after `most`."""
    waiting, found = [node], 0
    while waiting and found <= most:
        found += 1
        waiting.extend(waiting.pop().children())
    return found


@contextmanager
def bounded(source: Source, node: YamlNode) -> Iterator[None]:
    """Report values that are nested too deep for Python's stack.

    Raises:
        TooLarge: at the node.
    """
    try:
        yield
    except RecursionError:
        message = "values and templates are nested too deep"
        raise TooLarge(source, make_finding(node, message, KIND)) from None


def refuse_depth(source: Source, root: YamlNode) -> None:
    """Refuse values that templates have nested deeper than YAML may.

    Raises:
        TooLarge: at the first of them.
    """
    level = [root]
    for _ in range(DEEPEST + 1):
        level = [child for node in level for child in node.children()]
    if level:
        message = f"templates nest values more than {DEEPEST} deep"
        raise TooLarge(source, make_finding(level[0], message, KIND))

"""The kinds of preflight's problems, and the lists in their text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

import attrs

from rigel_k8s.problems import Problem

#: How to install Multus, whereabouts and the CNI programs.
INSTALL = "run `rigel network install`, or set `network: {install: true}` in the Rigelfile"


@attrs.frozen
class PreflightKind:
    """One kind of problem, as a constant beside its check; docs/errors.md lists them all.

    Attributes:
        cause: what is wrong: a clause in lower case, in Markdown.
        changes: who has to change something: the Rigelfile (exit code 2), the cluster (exit
            code 1), or no one, since it is a warning.
        found_by: where the answer comes from.
    """

    name: str
    cause: str
    changes: Literal["Rigelfile", "cluster", "warning"]
    found_by: str

    def problem(self, message: str, remedy: str) -> Problem:
        """Return a problem of this kind."""
        severity: Literal["error", "warning"] = "warning" if self.changes == "warning" else "error"
        return Problem((), message, self.name, severity, remedy=remedy)


UNSEEN = PreflightKind(
    "unseen",
    "something could not be examined",
    "warning",
    "",
)


def list_some(items: Iterable[object], most: int = 5) -> str:
    """Return items with commas; of many, the first ones and how many more there are."""
    texts = [str(item) for item in items]
    more = len(texts) - most
    return ", ".join(texts[:most]) + (f" and {more} more" if more > 0 else "")


def group_by_text(texts: Mapping[str, str]) -> dict[str, list[str]]:
    """Return each text once, with the machines that have it."""
    grouped: dict[str, list[str]] = {}
    for node, text in texts.items():
        grouped.setdefault(text, []).append(node)
    return grouped

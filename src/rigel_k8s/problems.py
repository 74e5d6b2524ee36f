"""What is wrong: with a Rigelfile, a cluster's network, a release's graph.

Every check returns Problems, wherever it looks. Only rigelfile/ finds the place of a path in the
text; a problem that is not in a Rigelfile has no path, and `subjects` instead.
"""

from __future__ import annotations

from typing import Any, Literal, TypeAlias

import attrs

Path: TypeAlias = tuple[str | int, ...]
Severity: TypeAlias = Literal["error", "warning"]


@attrs.frozen
class Problem:
    """One thing that the user should change.

    Attributes:
        path: keys and list indices from the root of what was checked to the offending value.
        message: what is wrong, one line, lower case, no full stop.
        kind: a short slug, shown in brackets, stable for scripts: `unknown-key`, `bad-quantity`.
        severity: an `error` stops everything, a `warning` is only printed.
        at_key: the place to show is the key itself, not its value.
        remedy: what to do next, where the message does not say it.
        subjects: the names of the pods, nodes or topics that it is about.
        because: other options that it follows from, from the root of what was checked; what is
            wrong with one of them may be the cause.
    """

    path: Path
    message: str
    kind: str
    severity: Severity = "error"
    at_key: bool = False
    remedy: str = ""
    subjects: tuple[str, ...] = ()
    because: tuple[Path, ...] = ()

    def __str__(self) -> str:
        return f"{'.'.join(map(str, self.path))}: {self.text}" if self.path else self.text

    @property
    def text(self) -> str:
        """The problem in one line, without the path."""
        remedy = f"; {self.remedy}" if self.remedy else ""
        return f"{self.message}{remedy} [{self.kind}]"

    def lines(self) -> list[str]:
        """Return the problem in a line, and its remedy below it: for one of several."""
        remedy = [f"    {self.remedy}"] if self.remedy else []
        return [f"{self.message} [{self.kind}]", *remedy]

    @property
    def is_error(self) -> bool:
        """Whether it stops what is about to happen, or breaks what was requested."""
        return self.severity == "error"

    def under(self, prefix: Path) -> Problem:
        """Return the same problem seen from a root further up."""
        return attrs.evolve(self, path=prefix + self.path)

    def to_json(self) -> dict[str, Any]:
        """Return the problem for scripts: the same form in the output of every command."""
        return attrs.asdict(self, filter=attrs.filters.exclude("at_key", "because"))

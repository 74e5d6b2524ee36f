"""What is wrong with a Rigelfile, by path, without lines and columns.

Packages that check options return Problems with paths into the options; only rigelfile/ finds the
place of a path in the text.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

import attrs

Path: TypeAlias = tuple[str | int, ...]


@attrs.frozen
class Problem:
    """One thing that the user should change.

    Attributes:
        path: keys and list indices from the root of what was checked to the offending value.
        message: what is wrong and what to do, one line, lower case, no full stop.
        kind: a short slug, shown in brackets, stable for scripts: `unknown-key`, `bad-quantity`.
        severity: an `error` stops everything, a `warning` is only printed.
        at_key: the place to show is the key itself, not its value.
    """

    path: Path
    message: str
    kind: str
    severity: Literal["error", "warning"] = "error"
    at_key: bool = False

    def __str__(self) -> str:
        return f"{'.'.join(map(str, self.path))}: {self.message} [{self.kind}]"

    def under(self, prefix: Path) -> Problem:
        """Return the same problem seen from a root further up."""
        return attrs.evolve(self, path=prefix + self.path)

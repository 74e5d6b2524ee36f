"""A finding about the graph."""

from __future__ import annotations

from collections.abc import Sequence

import attrs


@attrs.frozen
class GraphFinding:
    """One thing that is wrong, or that could not be checked.

    Attributes:
        kind: a word for scripts.
        remedy: what to do, "" if nothing can be done.
        pods: the pods that it is about.
        error: nodes do not discover each other, although the Rigelfile requests it.
    """

    kind: str
    message: str
    remedy: str
    pods: Sequence[str] = ()
    error: bool = False

    def __str__(self) -> str:
        said = f"{self.message}; {self.remedy}" if self.remedy else self.message
        return f"{said} [{self.kind}]"

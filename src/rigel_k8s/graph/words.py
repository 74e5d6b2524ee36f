"""A finding about the graph, and lists in words."""

from __future__ import annotations

from collections.abc import Sequence

import attrs


@attrs.frozen
class GraphFinding:
    """One thing that is wrong, or that could not be found out.

    Attributes:
        kind: a word for scripts.
        remedy: what to do, "" where nothing is to be done.
        pods: whom it is about.
        error: nodes are kept from each other against what the Rigelfile says.
    """

    kind: str
    message: str
    remedy: str
    pods: Sequence[str] = ()
    error: bool = False

    def __str__(self) -> str:
        return f"{self.message}; {self.remedy}" if self.remedy else self.message

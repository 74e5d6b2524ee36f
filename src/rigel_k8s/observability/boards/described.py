"""All dashboards as they are described, by the name of the file that each is kept in."""

from __future__ import annotations

from rigel_k8s.observability.boards import applications, graph, logs, machines
from rigel_k8s.observability.boards.board import Board

__all__ = ["boards"]


def boards() -> dict[str, Board]:
    """Return the dashboards by their files' names."""
    found = [applications.board(), graph.board(), logs.board(), machines.board()]
    return {f"{board.uid}.json": board for board in found}

"""A finding of preflight, and the lists in its text."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Literal

import attrs

#: How to install Multus, whereabouts and the CNI programs.
INSTALL = "run `rigel network install`, or set `network: {install: true}` in the Rigelfile"


@attrs.frozen
class PreflightFinding:
    """One thing that keeps the network from working, or may.

    Attributes:
        kind: a short slug, stable for scripts; kinds.py explains it.
        remedy: what to do next, one line.
        severity: an error stops the deploy, a warning is printed.
        fault: whether the Rigelfile must change (exit code 2), or the cluster.
    """

    kind: str
    message: str
    remedy: str
    severity: Literal["error", "warning"] = "error"
    fault: Literal["rigelfile", "cluster"] = "cluster"


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

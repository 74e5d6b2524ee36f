"""A release's DDS graph as columns of the status table, as lines below it, and as JSON."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from typing import Any

import attrs

from rigel_k8s.discovery.findings import DiscoveryGraph, PodGraph

HEADS = ("INTERFACE", "ADDRESS", "DISCOVERED")


def cells(graph: DiscoveryGraph, pod: str) -> list[str]:
    """Return one pod's cells: its interface, its address, discovered in how many other pods."""
    row = next((one for one in graph.pods if one.pod == pod), None)
    if row is None:
        return ["-"] * len(HEADS)
    return [row.interface or "all", row.address or "-", describe_discovery(row)]


def describe_discovery(row: PodGraph) -> str:
    """Return in how many other pods a pod was discovered, or what it connects through."""
    if row.reaches:
        return "over a server" if row.mode == "discovery-server" else "over a router"
    if row.discovered_by is None or not row.out_of:
        return "-"
    return f"{len(row.discovered_by)}/{row.out_of}"


def graph_lines(graph: DiscoveryGraph) -> Iterator[str]:
    """Yield what is wrong, and what to do: once if it is the same for several."""
    for problem, following in zip_longest(graph.problems, graph.problems[1:]):
        same = following is not None and following.remedy == problem.remedy
        yield f"{problem.message} [{problem.kind}]" if same else problem.text


def graph_json(graph: DiscoveryGraph | None) -> dict[str, Any] | None:
    """Return a graph for scripts (docs/discovery.md)."""
    if graph is None:
        return None
    return {
        "ok": not graph.problems,
        "deaf": [{"from": one, "to": other} for one, other in graph.deaf],
        "problems": [problem.to_json() for problem in graph.problems],
        "pods": [attrs.asdict(pod) for pod in graph.pods],
    }

"""What a kind of problem means: the words in brackets behind messages."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from difflib import get_close_matches

import attrs

from rigel_k8s.discovery.kinds import GRAPH
from rigel_k8s.errors import UserError
from rigel_k8s.kinds import KUBECTL, PODS, PROBLEMS, Kind
from rigel_k8s.network.preflight.kinds import PREFLIGHT
from rigel_k8s.rosgraph.kinds import ROS_GRAPH
from rigel_muto.agent.kinds import REFUSALS

_LINK = re.compile(r"\[([^]]*)\]\(([^)]*)\)")


@attrs.frozen
class Explanation:
    """A kind of problem.

    Attributes:
        group: where such problems are found.
        cause, remedy: plain text; the remedy is "" if there is nothing to do.
    """

    kind: str
    group: str
    cause: str
    remedy: str


def list_kinds() -> list[Explanation]:
    """Return all kinds, in the order of docs/errors.md; a kind of two groups is there twice."""
    return [
        Explanation(name, group, _strip(kind.cause), _strip(kind.remedy))
        for group, kinds in _list_groups()
        for name, kind in kinds.items()
    ]


def explain(kind: str) -> list[Explanation]:
    """Return what a kind means in each group that has it.

    Raises:
        UserError: it does not exist.
    """
    name = kind.strip().strip("[]")
    known = list_kinds()
    if found := [one for one in known if one.kind == name]:
        return found
    close = get_close_matches(name, {one.kind for one in known}, n=1)
    meant = f', did you mean "{close[0]}"?' if close else ""
    raise UserError(
        f'unknown kind "{name}"{meant}',
        hint="the kind is the word in brackets behind a message; `rigel explain` lists all",
    )


def _strip(markdown: str) -> str:
    """Return a text without its links, which a terminal cannot follow."""
    return _LINK.sub(r"\1", markdown)


def _list_groups() -> Iterator[tuple[str, Mapping[str, Kind]]]:
    for title, kinds in PROBLEMS.items():
        yield f"Rigelfile: {title}", kinds
    yield "Pods (`rigel status -o json`)", PODS
    yield "Pods (`kubectl get pods`)", KUBECTL
    for title, found in PREFLIGHT.items():
        yield f"Network: {title}", found
    yield "DDS graph", GRAPH
    yield "ROS graph", ROS_GRAPH
    yield "Muto's agent", REFUSALS

"""What a restarted master is missing, and what a living one has in addition; pure."""

from __future__ import annotations

from typing import Any, Iterable, Iterator, Set, Tuple

from rigel_gate.parameters import leaves, list_pieces
from rigel_gate.registry import PUBLISHER, ROSOUT, SERVICE, SUBSCRIBER, Registration
from rigel_gate.state import State

_PARTS = (PUBLISHER, SUBSCRIBER, SERVICE)

#: A user's own value of it is given back; roscore.py sets its default first.
SET_BY_ROSCORE = "/rosout_disable_topics_generation"

Known = Set[Tuple[str, str, str]]


def read_system(system: Any) -> Known:
    """Return {(kind, key, node)} of what `getSystemState` returns."""
    found: Known = set()
    for kind, part in zip(_PARTS, system or ()):
        found.update((kind, key, node) for key, nodes in part for node in nodes)
    return found


def find_lost_nodes(state: State, known: Known) -> list[str]:
    """Return the nodes of which a master is missing a topic or a service."""
    return [
        entry.name
        for entry in state.registry.nodes.values()
        if any(
            (one.kind, one.key, one.node) not in known
            for one in entry.registrations.values()
            if one.kind in _PARTS
        )
    ]


def find_lost_parameters(state: State, names: Iterable[str]) -> list[tuple[str, Any]]:
    """Return (name, value) of what a master is missing; whole trees, or large pieces of them."""
    there = set(names) - {SET_BY_ROSCORE}
    lost: list[tuple[str, Any]] = []
    for first, value in state.parameters.own().items():
        missing = [name for name in leaves(value, "/" + first) if name not in there]
        if missing and not any(
            name == "/" + first or name.startswith(f"/{first}/") for name in there
        ):
            is_tree = isinstance(value, dict)
            lost += list_pieces(value, "/" + first) if is_tree else [("/" + first, value)]
        else:
            lost += [(name, state.parameters.get(name)) for name in missing]
    return lost


def is_same_node(registrations: Iterable[Registration], publications: Any) -> bool:
    """Return whether a node that answers at an address can be the one that registered there.

    Another process may have got the address. Each node publishes something, /rosout at least. A
    node that has just stopped publishing some topics publishes nothing else, or another topic too.

    Args:
        publications: its answer to `getPublications`: [[topic, type], ...].
    """
    own = {one.key for one in registrations if one.kind == PUBLISHER}
    there = {entry[0] for entry in publications or ()}
    ceased = bool(there) and there <= own
    return own <= there or ceased or not (own & there) <= {ROSOUT}


def list_topics_without(gone: Iterable[Registration]) -> set[str]:
    """Return the topics that have lost a publisher."""
    return {one.key for one in gone if one.kind == PUBLISHER}


def find_unknown(state: State, known: Known) -> Iterator[tuple[str, str, str]]:
    """Yield (kind, key, node) of what only a master has, without roscore's own node."""
    for kind, key, node in sorted(known):
        entry = state.registry.nodes.get(node)
        if node != ROSOUT and (entry is None or (kind, key) not in entry.registrations):
            yield kind, key, node


def find_unregistered(state: State, known: Known) -> list[Registration]:
    """Return what the state has and a living master has not: its node has unregistered it."""
    return [
        one
        for one in state.registry.all()
        if one.kind in _PARTS and (one.kind, one.key, one.node) not in known
    ]


def list_refusals(answers: Any, count: int) -> list[str]:
    """Return why a master refused each call of a `system.multicall`, "" for those that it did not.

    Args:
        answers: its answer, one or a fault for each call; all are refused if it is anything else.
        count: how many calls it got.
    """
    if not isinstance(answers, list) or len(answers) != count:
        return [str(answers)] * count
    singles = [one[0] if isinstance(one, list) and one else one for one in answers]
    return ["" if isinstance(one, list) and one[:1] == [1] else str(one) for one in singles]

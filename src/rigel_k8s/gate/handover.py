"""Which registration waits for a name, and who gets the name next; pure."""

from __future__ import annotations

from typing import Iterator

from rigel_k8s.gate.registry import PUBLISHER, Registration, host_of
from rigel_k8s.gate.state import GatePod, Newcomer, State

#: Seconds without a registration after which a newcomer is taken to have registered all.
QUIET = 1.0


def find_owner(state: State, one: Registration, *, hands_over: bool) -> str | None:
    """Return the URI of the node that has the name and must not be shut down by this registration.

    None: the registration goes to the master. The caller looks whether the owner lives.

    Args:
        hands_over: the registration came by the door of nodes that hand over.
    """
    entry = state.registry.nodes.get(one.node)
    if not hands_over or entry is None or not entry.hands_over:
        return None
    host = host_of(entry.api)
    if host == one.host:
        return None
    if are_strangers(state.pods.get(host), state.pods.get(one.host)):
        return None
    return entry.api


def are_strangers(old: GatePod | None, new: GatePod | None) -> bool:
    """Return whether two pods are known to belong to different workloads."""
    return old is not None and new is not None and old.workload != new.workload


def find_strangers(state: State) -> Iterator[Newcomer]:
    """Yield newcomers that wait for a name of another workload: the younger one wins, as in ROS."""
    for newcomer in state.newcomers.values():
        api = state.registry.api_of(newcomer.name)
        host = host_of(api or "")
        if are_strangers(state.pods.get(host), state.pods.get(newcomer.host)):
            yield newcomer


def is_quiet(newcomer: Newcomer, now: float) -> bool:
    """Return whether a newcomer has registered all that it registers at its start."""
    return now - newcomer.quiet_since >= QUIET


def choose_heir(state: State, node: str, now: float) -> Newcomer | None:
    """Return who gets a name next: the latest that is quiet, else the latest, None for no one."""
    there = [one for one in state.newcomers_for(node) if not one.is_silent]
    waiting = [one for one in there if one.host not in state.leaving]
    return next((one for one in waiting if is_quiet(one, now)), waiting[0] if waiting else None)


def list_names_of(state: State, host: str) -> list[str]:
    """Return the names that nodes at an address have."""
    entries = state.registry.nodes.values()
    return [one.name for one in entries if host_of(one.api) == host]


def list_publishers(state: State, topic: str) -> list[str]:
    """Return the URIs of a topic's publishers."""
    return [one.api for one in state.registry.find(PUBLISHER, topic)]

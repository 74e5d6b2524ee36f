"""Which registration waits for a name, and which one gets the name next; pure."""

from __future__ import annotations

from typing import Iterator

from rigel_gate.calls import Removal
from rigel_gate.registry import PUBLISHER, SERVICE, SUBSCRIBER, Registration, host_of
from rigel_gate.state import GatePod, Newcomer, State

#: Seconds without a registration after which a newcomer counts as fully registered.
QUIET = 1.0
#: The type of the topics on which two processes of a pod notice each other's end. They give up
#: after ten seconds without the other one, and a nodelet is unloaded then.
BOND = "bond/Status"


def find_owner(state: State, one: Registration, *, hands_over: bool) -> str | None:
    """Return the URI of the node that has the name and must not be shut down by this registration.

    None: the registration is passed to the master. The caller checks whether the owner lives.

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
    """Return which newcomer gets a name next: the latest quiet one, else the latest, else None."""
    there = [one for one in state.newcomers_for(node) if not one.is_silent]
    waiting = [one for one in there if one.host not in state.leaving]
    return next((one for one in waiting if is_quiet(one, now)), waiting[0] if waiting else None)


def list_names_of(state: State, host: str) -> list[str]:
    """Return the names that nodes at an address have."""
    entries = state.registry.nodes.values()
    return [one.name for one in entries if host_of(one.api) == host]


def list_removals(state: State, node: str) -> frozenset[Removal]:
    """Return what a node unregisters when it unregisters everything."""
    entry = state.registry.nodes.get(node)
    found = entry.registrations.values() if entry else ()
    return frozenset(
        Removal(one.kind, one.key, one.node, one.detail if one.kind == SERVICE else one.api)
        for one in found
    )


def list_heard(state: State, topic: str, api: str) -> list[str]:
    """Return the URIs of the publishers of a topic that a node may receive.

    A newcomer receives only the other ends of its bonds.
    """
    newcomer = next((one for one in state.newcomers.values() if one.api == api), None)
    if newcomer is None or state.registry.api_of(newcomer.name) == api:
        return [one.api for one in state.registry.find(PUBLISHER, topic)]
    if not has_bond(newcomer, topic):
        return []
    ends = [one.registrations.get((PUBLISHER, topic)) for one in state.newcomers_at(newcomer.host)]
    return [one.api for one in ends if one]


def has_bond(newcomer: Newcomer, topic: str) -> bool:
    """Return whether a newcomer subscribes to a topic of bonds."""
    one = newcomer.registrations.get((SUBSCRIBER, topic))
    return one is not None and one.detail == BOND


def find_own_service(state: State, key: str, host: str) -> str | None:
    """Return the URI of a service that a waiting node of the pod at this address provides."""
    for newcomer in state.newcomers_at(host):
        own = newcomer.registrations.get((SERVICE, key))
        if own:
            return own.detail
    return None


def are_rivals(state: State, node: str, host: str, other: str) -> bool:
    """Return whether the pod at `host` replaces the one at `other`, or is replaced by it.

    They do not use each other's services. A nodelet of the new pod would be loaded into the manager
    that is about to end, and the old pod's end would unload it from the manager that has begun.

    Args:
        node: a name in the pod at `host`. Its namesake may be in the other pod.
    """
    names = {node, *(newcomer.name for newcomer in state.newcomers_at(host))}
    owners = {host_of(state.registry.api_of(name) or "") for name in names}
    one, two = state.pods.get(host), state.pods.get(other)
    are_replicas = one is not None and two is not None and one.workload == two.workload
    return host != other and (other in owners or are_replicas)

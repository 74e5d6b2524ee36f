"""Looks into all pods of a release at the same time: which nodes are there, which are discovered.

Processes of ROS 2 with the layer have noted both. For others (without the layer, or programs on
DDS alone) a participant of our own listens to discovery for some seconds; it shows
addresses, which differ by pod.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import partial, reduce
from operator import and_
from typing import Any

import attrs

from rigel_exporter.notes import list_nodes
from rigel_graph.discovery.inside import Unread, configure, listen, read_notes
from rigel_graph.discovery.losses import Flow, measure_flows
from rigel_graph.discovery.members import Member
from rigel_k8s.kube.cluster import Cluster

SPAN = 1.0  # seconds between two readings of notes
#: POD/CONTAINER -> what its processes noted, `first` and `second`.
Notes = Mapping[str, Mapping[str, Any]]


@attrs.frozen
class Observation:
    """What was seen in one pod.

    Attributes:
        problem: why the pod could not be examined, "" if it could.
        nodes: its ROS 2 nodes, and for how many seconds each has not looked for work.
        discovered: the nodes that each of its processes has discovered; None without notes.
        twice: those of them that it has discovered several of, by one name.
        heard: the addresses from which participants were heard; None with notes.
        flows: what its nodes have sent and taken during the look.
        notes: what its processes noted, `first` and `second`; None without a node that did.
    """

    problem: str = ""
    nodes: Mapping[str, float] = attrs.field(factory=dict)
    discovered: frozenset[str] | None = None
    twice: frozenset[str] = frozenset()
    heard: frozenset[str] | None = None
    flows: tuple[Flow, ...] = ()
    notes: Mapping[str, Mapping[str, Any]] | None = attrs.field(default=None, eq=False)

    @property
    def is_known(self) -> bool:
        """Whether discovery was read; without notes it cannot be in each domain."""
        return self.discovered is not None or self.heard is not None


def look(
    cluster: Cluster, found: Sequence[Member], known: Notes | None = None
) -> dict[str, Observation]:
    """Return pod -> what was seen in it; takes SPAN, without notes up to ten seconds.

    Args:
        known: notes that were read a moment ago.
    """
    seen = {member.pod: Observation(why_unseen(member)) for member in found}
    running = [member for member in found if not seen[member.pod].problem]
    looks = cluster.parallel(partial(look_into, cluster, running, known or {}), running)
    return seen | {m.pod: one for m, one in zip(running, looks, strict=True)}


def why_unseen(member: Member) -> str:
    """Return why nothing can be run in a pod, "" if it can."""
    if not member.reachable:
        return f"Kubernetes cannot reach the machine {member.machine}"
    return "" if member.running else "its container does not run"


def look_into(
    cluster: Cluster, members: Iterable[Member], known: Notes, member: Member
) -> Observation:
    """Return what is seen in one pod."""
    noted = Observation()
    try:
        if member.has_layer:
            notes = known.get(f"{member.name}/{member.container}")
            found = notes or read_notes(cluster, member, SPAN)
            if found["second"]["processes"]:
                noted = of_notes(found["second"])
            if noted.nodes:
                flows = measure_flows(found["first"], found["second"])
                return attrs.evolve(noted, flows=flows, notes=found)
        if member.middleware == "zenoh" or member.domain is None or member.own_ways:
            return noted  # how to join is unknown
        others = [one for one in members if one.domain == member.domain]
        config = configure([member, *others], member.domain)
        return Observation(heard=frozenset(listen(cluster, member, config)["addresses"]))
    except Unread as error:
        return Observation(error.reason)


def of_notes(answer: Mapping[str, Any]) -> Observation:
    """Return what a pod's processes have noted; all of them must have discovered a node."""
    with_nodes = [
        one
        for one in answer["processes"]
        if any(entity["kind"] == "node" for entity in one["entities"])
    ]
    names = {
        entity["name"]
        for one in with_nodes
        for entity in one["entities"]
        if entity["kind"] == "node"
    }
    stands = list_nodes({"": answer})
    counts = [Counter(one["seen"]) for one in with_nodes]
    discovered = reduce(and_, counts) if counts else Counter[str]()
    return Observation(
        nodes={name: stands.get(name, 0.0) for name in sorted(names)},
        discovered=frozenset(discovered),
        twice=frozenset(name for name, count in discovered.items() if count > 1),
    )

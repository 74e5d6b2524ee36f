"""Which machines' multicast arrives at which others, derived from the beacons received; pure."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

import attrs

from rigel_k8s.discovery.looks import Observation
from rigel_k8s.discovery.members import Member
from rigel_k8s.objects.text import join_words
from rigel_k8s.problems import Problem, Severity

SWITCH = (
    "check the network between them: a firewall, Wi-Fi that filters multicast, a switch with IGMP"
    " snooping and no querier (multicast then stops after minutes)"
)
SET_NETWORK = (
    "set `network`: macvlan if the machines share an Ethernet, otherwise peers or"
    " discovery-server, host on a single machine"
)


@attrs.frozen
class Paths:
    """Which multicast arrived.

    Attributes:
        heard: (from, to): machines whose pods' multicast arrives.
        deaf: (from, to): machines where it arrives in no pod; from == to: between pods of one.
        alone: (from, pod): it does not arrive in this pod, but in others of its machine.
    """

    heard: frozenset[tuple[str, str]] = frozenset()
    deaf: frozenset[tuple[str, str]] = frozenset()
    alone: frozenset[tuple[str, str]] = frozenset()

    def explains(self, one: Member, other: Member) -> bool:
        """Whether two pods cannot discover each other, since multicast of one does not arrive."""
        deaf = {(one.machine, other.machine), (other.machine, one.machine)} & self.deaf
        return bool(deaf or {(one.machine, other.pod), (other.machine, one.pod)} & self.alone)


def paths(looked: Sequence[Member], seen: Mapping[str, Observation]) -> Paths:
    """Return which multicast arrives where; pods without their interface are ignored."""
    able = [m for m in looked if m.by_multicast and seen[m.pod].is_on_network(m)]
    senders = [m for m in able if seen[m.pod].sends]
    arrived: dict[tuple[str, str], dict[str, bool]] = defaultdict(dict)
    for sender in senders:
        for other in able:
            if other.pod != sender.pod and other.domain == sender.domain:
                way = (sender.machine, other.machine)
                arrived[way][other.pod] = sender.pod in seen[other.pod].beacons
    heard = {way for way, pods in arrived.items() if any(pods.values())}
    alone = {(w[0], pod) for w in heard for pod, does in arrived[w].items() if not does}
    return Paths(frozenset(heard), frozenset(set(arrived) - heard), frozenset(alone))


def find_deaf(looked: Sequence[Member], ways: Paths) -> Iterator[Problem]:
    """Yield which machines receive no multicast from which others."""
    bare = any(m.mode == "none" for m in looked)
    names = [f"at {name}" for name in sorted({m.interface for m in looked if m.interface})]
    where = f" {names[0]}" if names else ""
    if bare and ways.deaf and not any(a != b for a, b in ways.heard):
        yield bare_finding(looked, ways)
        return
    remedy = SET_NETWORK if bare else SWITCH
    severity: Severity = "warning" if bare else "error"
    for message, machines in deaf_messages(ways, where):
        pods = tuple(m.pod for m in looked if m.machine in machines)
        yield Problem((), message, "deaf", severity, remedy=remedy, subjects=pods)
    for one, pod in sorted(ways.alone):
        message = f"multicast from {one} reaches the machine of {pod}, but not this pod"
        remedy = "delete the pod; if that does not help, see `kubectl describe pod`"
        yield Problem((), message, "deaf-pod", severity, remedy=remedy, subjects=(pod,))


def deaf_messages(ways: Paths, where: str) -> Iterator[tuple[str, set[str]]]:
    """Yield messages and their machines: first the machines that no multicast reaches."""
    cut = sorted(find_cut_off(ways))
    for machine in cut:
        yield (
            f"no multicast{where} passes between {machine} and any other machine",
            {machine},
        )
    for one, other in sorted(ways.deaf):
        both = (other, one) in ways.deaf and one != other
        reported = {one, other} & set(cut) and one != other
        if reported or (both and other < one):
            continue
        yield deaf_message(one, other, where, both=both), {one, other}


def find_cut_off(ways: Paths) -> set[str]:
    """Return the machines without multicast from or to any other, if there are three or more."""
    machines = {name for way in ways.heard | ways.deaf for name in way}
    if len(machines) < 3 or not any(a != b for a, b in ways.heard):
        return set()
    across = {way for way in ways.heard if way[0] != way[1]}
    return machines - {name for way in across for name in way}


def deaf_message(one: str, other: str, where: str, *, both: bool) -> str:
    """Return in which direction multicast does not arrive, as a message."""
    if one == other:
        return f"pods on {one} do not receive each other's multicast{where}"
    if both:
        return f"no multicast{where} passes between {one} and {other}"
    return f"multicast{where} from {one} does not reach {other}"


def bare_finding(looked: Sequence[Member], ways: Paths) -> Problem:
    """Return the finding that the pod network carries no multicast."""
    machines = sorted({name for way in ways.deaf for name in way})
    within = any(one == other for one, other in ways.deaf)
    message = (
        f"the pods on {join_words(machines)} do not discover each other: the pod network carries no"
        f" multicast{'' if within else ' from machine to machine'}"
    )
    pods = tuple(member.pod for member in looked)
    return Problem((), message, "deaf", "warning", remedy=SET_NETWORK, subjects=pods)

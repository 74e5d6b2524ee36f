"""What the looks into a release's pods show: which pods discover which, and what is wrong; pure.

Discovery needs packets in both directions, so two pods discover each other or they do not. If no
two pods of two machines do, the network between the machines is the cause.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_graph.discovery.looks import Observation
from rigel_graph.discovery.losses import find_losses
from rigel_graph.discovery.members import Member
from rigel_graph.problems import STANDS, describe_stand
from rigel_k8s.network.modes import mode_named
from rigel_k8s.network.modes.peers import peer_name
from rigel_k8s.objects.text import join_words
from rigel_k8s.problems import Problem, Severity

SWITCH = (
    "check the network between them: a firewall, Wi-Fi that filters multicast, a switch with IGMP"
    " snooping and no querier (multicast then stops after minutes)"
)
OWN = (
    "check whether its image sets ROS_DOMAIN_ID or limits DDS (ROS_LOCALHOST_ONLY,"
    " ROS_AUTOMATIC_DISCOVERY_RANGE, a profile), or a firewall drops UDP"
)

#: Pod -> other pod -> whether both have discovered each other.
Known = Mapping[str, Mapping[str, bool]]


@attrs.frozen
class PodGraph:
    """One pod's place in the graph.

    Attributes:
        interface: the one that DDS uses, "" for all.
        address: that of the interface, "" for none; without an interface, that of the pod.
        domain: its DDS domain, None if its image decides.
        discovered_by: the pods that it discovers, and that discover it; None if that is unknown (no
            pod could be examined, or how to join discovery is unknown).
        out_of: how many other pods were examined.
        memory: the pod or the machine whose memory it shares with others, "" for none.
    """

    pod: str
    machine: str
    mode: str
    domain: int | None
    interface: str
    address: str
    discovered_by: tuple[str, ...] | None
    out_of: int
    memory: str = ""


@attrs.frozen
class DiscoveryGraph:
    """A release's graph.

    Attributes:
        deaf: pairs of machines no two pods of which discover each other.
        notes: POD/CONTAINER -> what its processes noted, as a graph is made of it.
    """

    pods: tuple[PodGraph, ...]
    deaf: tuple[tuple[str, str], ...]
    problems: tuple[Problem, ...]
    notes: Mapping[str, Mapping[str, Any]] = attrs.field(factory=dict, eq=False, repr=False)

    @property
    def errors(self) -> tuple[Problem, ...]:
        """The problems that contradict what the Rigelfile requests."""
        return tuple(problem for problem in self.problems if problem.is_error)


def graph(found: Sequence[Member], seen: Mapping[str, Observation]) -> DiscoveryGraph:
    """Return the graph that the looks show."""
    looked = [member for member in found if not seen[member.pod].problem]
    absent = [member for member in looked if is_absent(member, seen[member.pod])]
    known = discoveries([member for member in looked if member not in absent], seen)
    deaf = find_deaf(looked, known)
    problems = [
        *explain_unseen(found, seen),
        *map(explain_absence, absent),
        *(
            describe_stand(node, seconds)
            for member in looked
            for node, seconds in seen[member.pod].nodes.items()
            if seconds > STANDS
        ),
        *(problem for member in looked for problem in explain_full(member, seen[member.pod])),
        *(loss.problem for loss in find_losses(flow for m in looked for flow in seen[m.pod].flows)),
        *explain_deaf(deaf, looked),
        *explain_undiscovered(looked, known, deaf),
    ]
    rows = tuple(row(member, known.get(member.pod)) for member in found)
    notes = {f"{m.name}/{m.container}": its for m in looked if (its := seen[m.pod].notes)}
    return DiscoveryGraph(rows, deaf, tuple(problems), notes)


def row(member: Member, known: Mapping[str, bool] | None) -> PodGraph:
    """Return one pod's place in the graph."""
    return PodGraph(
        member.pod,
        member.machine,
        member.mode,
        member.domain,
        member.interface or "",
        (member.address if member.interface else member.ip) or "",
        None if known is None else tuple(sorted(pod for pod, does in known.items() if does)),
        len(known or {}),
        member.memory,
    )


def is_absent(member: Member, seen: Observation) -> bool:
    """Whether nothing in a pod takes part, as far as that can be seen."""
    if seen.discovered is not None:
        return not seen.nodes
    return seen.heard is not None and address_of(member) not in seen.heard


def address_of(member: Member) -> str:
    """Return the address from which others hear a pod."""
    return str((member.interface and member.address) or member.ip)


def discoveries(members: Sequence[Member], seen: Mapping[str, Observation]) -> Known:
    """Return which pods have discovered each other.

    What a process whose executor stands still has discovered cannot be seen: it notes that with its
    turns. With peers, others find a pod by a name that leads to it when it is ready, not before.
    """
    known: dict[str, dict[str, bool]] = defaultdict(dict)
    able = [member for member in members if seen[member.pod].is_known]
    matched = find_matched(able, seen)
    forgetful = {pod for pod, other in matched if not knows_names(seen[pod], seen[other])}
    forgetful |= {one.pod for one in able if max(seen[one.pod].nodes.values(), default=0) > STANDS}

    nameless = {one.pod for one in able if mode_named(one.mode).lists_peers and not one.ready}

    def found(a: Member, b: Member) -> bool | None:
        does = (a.pod, b.pod) in matched or discovers(a, b, seen)
        unknown = a.pod in forgetful or not nameless.isdisjoint((a.pod, b.pod))
        return None if not does and unknown else does

    for one in able:
        for other in able:
            if other is not one and other.domain == one.domain:
                does = found(other, one), found(one, other)
                if None not in does:
                    known[one.pod][other.pod] = all(does)
    return known


def discovers(member: Member, other: Member, seen: Mapping[str, Observation]) -> bool | None:
    """Whether a pod has discovered the nodes of another one; None if that cannot be seen."""
    own, its = seen[member.pod], seen[other.pod]
    if own.discovered is None:
        return address_of(other) in (own.heard or ())
    return knows_names(own, its) if its.nodes else None


def knows_names(own: Observation, its: Observation) -> bool:
    """Whether a pod knows the names of another one's nodes; its own ones, as another node's."""
    names = frozenset(its.nodes)
    return names <= (own.discovered or frozenset()) and names & set(own.nodes) <= own.twice


def find_matched(
    members: Iterable[Member], seen: Mapping[str, Observation]
) -> set[tuple[str, str]]:
    """Return pairs of pods the first of which has discovered the second, as their topics show.

    Fast DDS sends the names of nodes once: after a cut of the network their messages flow again,
    and their names are missing, in `ros2 node list` too. An end that has as many partners as its
    topic has other ends has found all of them. Whether a pod that does not know the names of such
    partners has discovered those with which it has no topic cannot be seen.
    """
    ends: dict[tuple[int | None, str, bool], list[tuple[str, int]]] = defaultdict(list)
    for member in members:
        for flow in seen[member.pod].flows:
            ends[member.domain, flow.topic, flow.sent].append((member.pod, flow.partners))
    return {
        (pod, other)
        for (domain, topic, sent), mine in ends.items()
        for pod, partners in mine
        if partners >= len(others := ends.get((domain, topic, not sent), []))
        for other, _ in others
    }


def find_deaf(looked: Sequence[Member], known: Known) -> tuple[tuple[str, str], ...]:
    """Return pairs of machines no two pods of which discover each other."""
    machine = {member.pod: member.machine for member in looked}
    between: dict[tuple[str, str], list[bool]] = defaultdict(list)
    for pod, others in known.items():
        for other, does in others.items():
            if machine[pod] < machine[other]:
                between[machine[pod], machine[other]].append(does)
    return tuple(sorted(pair for pair, found in between.items() if not any(found)))


def severity_of(member: Member) -> Severity:
    """Return how serious it is that a pod is not discovered: `network` promises it."""
    return "error" if mode_named(member.mode).connects else "warning"


def explain_unseen(found: Sequence[Member], seen: Mapping[str, Observation]) -> Iterator[Problem]:
    """Yield why pods could not be examined; pods with the same cause together."""
    reasons: dict[str, list[str]] = defaultdict(list)
    for member in found:
        if seen[member.pod].problem:
            reasons[seen[member.pod].problem].append(member.pod)
    for reason, pods in reasons.items():
        message = f"{join_words(pods)} could not be checked: {reason}"
        yield Problem((), message, "not-looked", "warning", subjects=tuple(pods))


def explain_absence(member: Member) -> Problem:
    """Return the problem of a pod in which nothing takes part."""
    what = "ROS 2 node" if member.has_layer else "DDS participant"
    message = f"{member.pod} has no {what}"
    severity: Severity = severity_of(member) if member.probed else "warning"
    remedy = "check its log: did its program start, in the right domain, and is it still running?"
    return Problem((), message, "no-participant", severity, remedy=remedy, subjects=(member.pod,))


def explain_full(member: Member, seen: Observation) -> Iterator[Problem]:
    """Yield a pod with more topics and services than its processes have room to note."""
    processes = seen.notes["second"]["processes"] if seen.notes else ()
    if full := sum(int(process["full"]) for process in processes):
        message = f"{member.pod}: the graph lacks {full} of its topics and services"
        remedy = "divide the node: a process notes 2048"
        yield Problem((), message, "not-noted", "warning", remedy=remedy, subjects=(member.pod,))


def explain_deaf(deaf: Sequence[tuple[str, str]], looked: Sequence[Member]) -> Iterator[Problem]:
    """Yield which machines are cut off from each other: first those that are from all others."""
    machines = sorted({member.machine for member in looked})
    degree = {name: sum(name in pair for pair in deaf) for name in machines}
    cut = [name for name in machines if len(machines) > 2 and degree[name] == len(machines) - 1]
    everywhere = cut == machines
    which = "different machines" if everywhere else f"{join_words(cut)} and on other machines"
    groups = [(cut, f"the pods on {which}")] if cut else []
    groups += [
        (list(pair), f"the pods on {join_words(pair)}") for pair in deaf if not set(cut) & set(pair)
    ]
    for names, which in groups:
        pods = [member for member in looked if member.machine in names]
        counts = Counter(member.machine for member in looked)
        lone = [member.pod for member in pods if counts[member.machine] == 1]
        remedy = mode_named(pods[0].mode).remedy or SWITCH
        if lone and not everywhere:
            remedy += f"; or does the image of {' or '.join(lone[:2])} set ROS_DOMAIN_ID?"
        yield Problem(
            (),
            f"{which} do not discover each other",
            "deaf",
            severity_of(pods[0]),
            remedy=remedy,
            subjects=tuple(member.pod for member in pods),
        )


def explain_undiscovered(
    looked: Sequence[Member], known: Known, deaf: Sequence[tuple[str, str]]
) -> Iterator[Problem]:
    """Yield pods that miss others, unless their machines explain it: each once, the worst first."""
    by_pod = {member.pod: member for member in looked}
    missing = {
        pod: {
            other
            for other, does in others.items()
            if not does and pair_of(by_pod[pod], by_pod[other]) not in deaf
        }
        for pod, others in known.items()
    }
    while pod := max(missing, key=lambda pod: len(missing[pod]), default=None):
        others = missing.pop(pod)
        if not others:
            return
        for rest in missing.values():
            rest.discard(pod)
        member = by_pod[pod]
        which = "any other pod" if len(others) == len(known[pod]) else join_words(sorted(others))
        message = f"{pod} is not discovered by {which}"
        remedy = OWN
        if mode_named(member.mode).lists_peers:
            service = peer_name(member.workload)
            remedy = f"check that the Service {service} exists, and no NetworkPolicy blocks UDP"
        severity = severity_of(member)
        yield Problem((), message, "undiscovered", severity, remedy=remedy, subjects=(pod,))


def pair_of(one: Member, other: Member) -> tuple[str, str]:
    """Return two pods' machines."""
    return min(one.machine, other.machine), max(one.machine, other.machine)

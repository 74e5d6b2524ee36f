"""What the looks into a release's pods show: which pods discover which, and what is wrong; pure.

Where multicast arrives at all is derived from the beacons that the pods received.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

import attrs

from rigel_k8s.discovery.looks import Observation
from rigel_k8s.discovery.members import Member
from rigel_k8s.network.modes.peers import peer_name
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
class PodGraph:
    """One pod's place in the graph.

    Attributes:
        interface: the one that DDS uses, "" for all.
        address: that of the interface, "" for none; without an interface, that of the pod.
        domain: its DDS domain, None if its image decides.
        discovered_by: the pods in which a stand-in discovered it; None if that is unknown (a
            discovery server or a zenoh router is between them, or no pod could be examined).
        out_of: how many other pods were examined.
        reaches: the discovery servers and zenoh routers that it reaches.
    """

    pod: str
    machine: str
    mode: str
    domain: int | None
    interface: str
    address: str
    discovered_by: tuple[str, ...] | None
    out_of: int
    reaches: tuple[str, ...] = ()


@attrs.frozen
class DiscoveryGraph:
    """A release's DDS graph.

    Attributes:
        deaf: (from, to): multicast of the first machine's pods does not reach those of the second.
    """

    pods: tuple[PodGraph, ...]
    deaf: tuple[tuple[str, str], ...]
    problems: tuple[Problem, ...]

    @property
    def errors(self) -> tuple[Problem, ...]:
        """The problems that contradict what the Rigelfile requests."""
        return tuple(problem for problem in self.problems if problem.is_error)


def graph(found: Sequence[Member], seen: Mapping[str, Observation]) -> DiscoveryGraph:
    """Return the graph that the looks show."""
    looked = [member for member in found if not seen[member.pod].problem]
    ways = paths(looked, seen)
    known = discoveries(looked, seen)
    findings = [
        *find_unseen(found, seen),
        *(finding for member in looked for finding in check_pod(member, seen[member.pod])),
        *find_deaf(looked, ways),
        *find_undiscovered(looked, seen, known, ways),
    ]
    rows = tuple(row(member, seen[member.pod], known.get(member.pod)) for member in found)
    return DiscoveryGraph(rows, tuple(sorted(ways.deaf)), tuple(findings))


def row(member: Member, seen: Observation, known: Mapping[str, bool] | None) -> PodGraph:
    """Return one pod's place in the graph."""
    address = seen.interfaces.get(member.interface) if member.interface else member.ip
    if seen.problem:
        address = member.address  # from Multus' annotation, not checked
    reached = [server for server, answers in seen.servers.items() if answers]
    return PodGraph(
        member.pod,
        member.machine,
        member.mode,
        member.domain,
        member.interface or "",
        address or "",
        None if known is None else tuple(sorted(pod for pod, does in known.items() if does)),
        len(known or {}),
        (*reached, *seen.routers),
    )


def discoveries(
    looked: Sequence[Member], seen: Mapping[str, Observation]
) -> dict[str, dict[str, bool]]:
    """Return pod -> other pod -> whether a stand-in there discovered all its participants."""
    known: dict[str, dict[str, bool]] = {}
    heard = {m.pod: {p["prefix"] for p in seen[m.pod].heard} for m in looked}
    for member in looked:
        if not member.answers or member.middleware == "zenoh" or member.own_ways:
            continue
        own = {p["prefix"] for p in seen[member.pod].heard if p["own"]}
        known[member.pod] = {
            other.pod: bool(own) and own <= heard[other.pod]
            for other in looked
            if other.pod != member.pod and other.domain == member.domain
            if seen[other.pod].announced or looks_for(other, member)
            if seen[other.pod].is_on_network(other)
        }
    return known


def looks_for(other: Member, member: Member) -> bool:
    """Whether one member's stand-in looks for another member by its Service."""
    return other.mode == "peers" and other.workload != member.workload


def find_unseen(found: Sequence[Member], seen: Mapping[str, Observation]) -> Iterator[Problem]:
    """Yield why pods could not be examined; pods with the same cause together."""
    reasons: dict[str, list[str]] = defaultdict(list)
    for member in found:
        if seen[member.pod].problem:
            reasons[seen[member.pod].problem].append(member.pod)
    for reason, pods in reasons.items():
        message = f"{join_words(pods)} could not be checked: {reason}"
        yield Problem((), message, "not-looked", "warning", subjects=tuple(pods))


def check_pod(member: Member, seen: Observation) -> Iterator[Problem]:
    """Yield what is wrong inside one pod."""
    wrong = list(interface_findings(member, seen))
    if not wrong and member.middleware == "zenoh":
        if not seen.routers:
            remedy = (
                "check that the router's pod runs, its Service exists, and TCP port 7447 is open"
            )
            wrong = [("no-router", "is not connected to a zenoh router", remedy)]
    elif not wrong:
        wrong = [*participant_findings(member, seen), *server_findings(member, seen)]
    for kind, message, remedy in wrong:
        promised = member.mode != "none" and (member.probed or kind != "no-participant")
        severity: Severity = "error" if promised else "warning"
        yield Problem(
            (),
            f"{member.pod} {message}",
            kind,
            severity,
            remedy=remedy,
            subjects=(member.pod,),
        )


Wrong = tuple[str, str, str]


def interface_findings(member: Member, seen: Observation) -> Iterator[Wrong]:
    """Yield what is wrong with the interface that DDS uses."""
    name = member.interface
    if not name:
        return
    if name not in seen.interfaces:
        text = f"has no {name}: Multus did not attach the second network when the pod started"
        remedy = f"delete the pod when Multus runs on {member.machine}: a new one gets {name}"
        yield "no-interface", text, remedy
    elif not seen.interfaces[name]:
        remedy = "`kubectl describe pod` shows the message of the address management"
        yield "no-address", f"has {name} without an IPv4 address", remedy
    elif name in seen.down:
        remedy = "it was taken down in the pod, or the machine's interface lost its link"
        yield "interface-down", f"has {name}, but it is down", remedy
    elif member.address and seen.interfaces[name] != member.address:
        text = f"has the address {seen.interfaces[name]} at {name} instead of {member.address}"
        yield "other-address", text, "delete the pod: a new one gets the right address"


def participant_findings(member: Member, seen: Observation) -> Iterator[Wrong]:
    """Yield what is wrong with the pod's own participants."""
    domains = sorted({p["domain"] for p in seen.own if p["domain"] is not None})
    here = [p for p in seen.own if member.domain in (None, p["domain"])]
    stopped = [p for p in here if p["stopped"]]
    if not here and domains:
        text = (
            f"takes part in DDS domain {join_words(map(str, domains))} instead of {member.domain}"
        )
        yield "wrong-domain", text, "check whether its image or command sets ROS_DOMAIN_ID"
    elif not here:
        remedy = "check its log: did its program start DDS, and is it still running?"
        yield "no-participant", "has no DDS participant", remedy
    elif stopped:
        text = f"has a process that a signal has stopped: {stopped[0]['command']}"
        yield "stopped", text, "end the debugger, send SIGCONT, or delete the pod"
    elif member.answers and not any(p["own"] for p in seen.heard):
        text = f"has a participant that does not answer: {here[0]['command']}"
        yield "silent", text, "its process hangs, or DDS is bound to another interface"


def server_findings(member: Member, seen: Observation) -> Iterator[Wrong]:
    """Yield which discovery servers do not answer."""
    silent = [server for server, answers in seen.servers.items() if not answers]
    if silent:
        remedy = "check that the server's pod runs, its Service exists, and UDP passes both ways"
        yield "no-server", f"gets no answer from the discovery server {join_words(silent)}", remedy


def find_undiscovered(
    looked: Sequence[Member],
    seen: Mapping[str, Observation],
    known: Mapping[str, Mapping[str, bool]],
    ways: Paths,
) -> Iterator[Problem]:
    """Yield pods that are not discovered, if no other finding explains it."""
    by_pod = {member.pod: member for member in looked}
    for pod, others in known.items():
        member = by_pod[pod]
        if list(check_pod(member, seen[pod])):
            continue
        missing = [
            other
            for other, does in others.items()
            if not does and not ways.explains(member, by_pod[other])
        ]
        if not missing:
            continue
        remedy = (
            "check whether its image limits DDS (ROS_LOCALHOST_ONLY, ROS_AUTOMATIC_DISCOVERY_RANGE,"
            " a profile), or a firewall drops UDP"
        )
        if member.mode == "peers":
            service = peer_name(member.workload)
            remedy = f"check that the Service {service} exists, and no NetworkPolicy blocks UDP"
        which = "any other pod" if len(missing) == len(others) else join_words(missing)
        severity: Severity = "error" if member.mode != "none" else "warning"
        message = f"{pod} is not discovered by {which}"
        yield Problem((), message, "undiscovered", severity, remedy=remedy, subjects=(pod,))


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

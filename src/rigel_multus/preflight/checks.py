"""The checks: what keeps a release's network from working on this cluster.

The roll-out names the causes that are not here, such as a kernel without macvlan, when the first
pod starts. A check is here if pods would start and hear nothing, or would not start anywhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Literal

import attrs

from rigel_k8s.network.modes import mode_of
from rigel_k8s.problems import Problem
from rigel_multus.manifests import STANDARD
from rigel_multus.preflight.attachments import ON_AN_INTERFACE, AddressRange, AttachmentFacts
from rigel_multus.preflight.case import Case
from rigel_multus.preflight.machine import Daemon, Interface, MachineFacts, Subnet

#: How to install Multus, whereabouts and the CNI programs.
INSTALL = "run `rigel network install`, or set `network: {install: true}` in the Rigelfile"
#: Interfaces that networks of pods and container engines have made: not meant for attachments.
OTHERS = ("lo", "veth", "cali", "lxc", "cni", "flannel", "docker", "kube-", "br-", "cilium", "tunl")


@attrs.frozen
class PreflightKind:
    """One kind of problem; docs/errors.md lists them all.

    Attributes:
        cause: what is wrong: a clause in lower case, in Markdown.
        changes: who has to change something: the Rigelfile (exit code 2), the cluster (exit
            code 1), or no one, since it is a warning.
        found_by: where the answer comes from.
    """

    name: str
    cause: str
    changes: Literal["Rigelfile", "cluster", "warning"]
    found_by: str

    def problem(self, message: str, remedy: str) -> Problem:
        severity: Literal["error", "warning"] = "warning" if self.changes == "warning" else "error"
        return Problem((), message, self.name, severity, remedy=remedy)


MULTUS_MISSING = PreflightKind(
    "multus-missing",
    "the cluster has no NetworkAttachmentDefinition",
    "cluster",
    "the kinds of the API",
)
WHEREABOUTS_MISSING = PreflightKind(
    "whereabouts-missing",
    "`ipam: whereabouts`, and the cluster has no IPPool",
    "cluster",
    "the kinds of the API",
)
ATTACHMENT_MISSING = PreflightKind(
    "attachment-missing",
    "the named attachment does not exist",
    "Rigelfile",
    "NetworkAttachmentDefinitions of all namespaces",
)
MULTUS_NOT_ON_NODE = PreflightKind(
    "multus-not-on-node",
    "a machine has no Multus daemon",
    "cluster",
    "pods of DaemonSets with Multus' image or name",
)
MULTUS_NOT_READY = PreflightKind(
    "multus-not-ready",
    "a machine's daemon is not ready, so pods would start without net1",
    "cluster",
    "the pod's conditions",
)
PROGRAM_MISSING = PreflightKind(
    "program-missing",
    "a machine has no program macvlan, whereabouts, static or the like",
    "cluster",
    "the directory of CNI programs on the machine",
)
INTERFACE_MISSING = PreflightKind(
    "interface-missing",
    "a machine does not have this interface; the message lists those that it has",
    "Rigelfile",
    "`/sys/class/net`",
)
INTERFACE_WIRELESS = PreflightKind(
    "interface-wireless",
    "macvlan over Wi-Fi: access points drop further MAC addresses",
    "Rigelfile",
    "`wireless` or `phy80211` in `/sys/class/net/NAME`, or `DEVTYPE=wlan`",
)
INTERFACE_DOWN = PreflightKind(
    "interface-down",
    "the interface is switched off",
    "cluster",
    "`/sys/class/net/NAME/flags`",
)
MTU = PreflightKind(
    "mtu",
    "`network.mtu` is larger than that of the interface",
    "Rigelfile",
    "`/sys/class/net/NAME/mtu`",
)
MACHINE_ADDRESS = PreflightKind(
    "machine-address",
    "pods would get addresses of machines",
    "Rigelfile",
    "addresses of the nodes, from Kubernetes and from the machines",
)
TOO_FEW_ADDRESSES = PreflightKind(
    "too-few-addresses",
    "there are more pods than addresses (`static`, `whereabouts`, `host-local`)",
    "Rigelfile",
    "counting",
)
POD_NETWORK = PreflightKind(
    "pod-network",
    "the subnet overlaps that of the pods",
    "Rigelfile",
    "`podCIDRs` of all nodes",
)
SERVICE_NETWORK = PreflightKind(
    "service-network",
    "the subnet overlaps that of the Services",
    "Rigelfile",
    "ServiceCIDRs (Kubernetes 1.33 and newer), the Service `kubernetes`",
)
UNSEEN = PreflightKind(
    "unseen",
    "something could not be examined",
    "warning",
    "",
)

KINDS: Mapping[str, PreflightKind] = {
    value.name: value for value in list(globals().values()) if isinstance(value, PreflightKind)
}


def find_problems(case: Case) -> list[Problem]:
    """Return everything that keeps a release's network from working, each once."""
    checks: Sequence[Callable[[Case], Iterator[Problem]]] = (
        check_multus,
        check_programs,
        check_interfaces,
        check_addresses,
        check_room,
    )
    return list(dict.fromkeys(problem for check in checks for problem in check(case)))


def check_multus(case: Case) -> Iterator[Problem]:
    """Yield machines without Multus, and attachments that do not exist."""
    if not case.keys:
        return
    if not case.view.multus:
        yield MULTUS_MISSING.problem(
            "Multus is not installed: the cluster has no kind NetworkAttachmentDefinition",
            INSTALL,
        )
        return
    if not case.view.whereabouts and any(one.ipam == "whereabouts" for one in case.attachments):
        yield WHEREABOUTS_MISSING.problem(
            "whereabouts is not installed: the cluster has no kind IPPool",
            f"{INSTALL}; or use another `network.ipam`",
        )
    if case.view.daemons is not None:
        yield from check_daemons(case, case.view.daemons)
    known = {*case.view.attachments, *case.own, *case.view.unread}
    there = list_some(sorted(case.view.attachments)) or "none"
    for key in (key for key in case.keys if key not in known):
        yield ATTACHMENT_MISSING.problem(
            f"the NetworkAttachmentDefinition {key} does not exist (the cluster has: {there})",
            "set `network.attachment` to an existing one, as NAMESPACE/NAME, or create it",
        )


def check_daemons(case: Case, daemons: Mapping[str, Daemon]) -> Iterator[Problem]:
    """Yield the machines whose Multus is missing or not ready; unreachable ones are skipped."""
    nodes = [node for node in case.nodes() if node in case.ready]
    missing = [node for node in nodes if node not in daemons]
    if missing:
        yield MULTUS_NOT_ON_NODE.problem(
            f"no Multus daemon runs on {list_some(missing)}, where pods of the release may run",
            f"{INSTALL}; or keep the pods away from these machines with `placement`",
        )
    for daemon in (daemons[node] for node in nodes if node in daemons):
        if daemon.state:
            yield MULTUS_NOT_READY.problem(
                f"the Multus daemon on {daemon.node} is not ready: {daemon.state}",
                f"kubectl -n {daemon.namespace} logs {daemon.pod} -c {daemon.container}",
            )


def check_programs(case: Case) -> Iterator[Problem]:
    """Yield CNI programs that are missing on machines."""
    for one in case.attachments:
        missing: dict[str, str] = {}
        remedies: dict[str, str] = {}
        for node, facts in case.machines(one).items():
            there = frozenset().union(*facts.programs.values())
            names = [name for name in dict.fromkeys(one.programs) if name not in there]
            if facts.programs and names:
                missing[node] = f"{list_some(names)} (looked into {list_some(facts.programs)})"
                remedies[missing[node]] = suggest_source(names)
        for text, nodes in group_by_text(missing).items():
            message = f"CNI programs are missing on {list_some(nodes)}: {text}"
            yield PROGRAM_MISSING.problem(message, remedies[text])


def suggest_source(names: Iterable[str]) -> str:
    """Return how to install CNI programs; on some platforms `install` brings the standard ones."""
    if set(names) <= {"whereabouts"}:
        return INSTALL
    if set(names) <= {"whereabouts", *STANDARD.split()}:
        return (
            "on k3s and kind, set `network: {install: true}`; elsewhere, set"
            " `network.install.plugins_image` to an image that has them, or unpack the CNI plugins'"
            " release in that directory"
        )
    return "put them into that directory on each of these machines"


def check_interfaces(case: Case) -> Iterator[Problem]:
    """Yield what is wrong with the interfaces that attachments, or pods themselves, use."""
    if mode_of(case.network).in_machine_network and case.network.interface:
        yield from check_presence(
            case.machines(), dict.fromkeys(case.machines(), case.network.interface)
        )
    for one in case.attachments:
        if one.program in ON_AN_INTERFACE:
            machines = case.machines(one)
            names = {n: one.master or facts.default_interface for n, facts in machines.items()}
            masters = {node: name for node, name in names.items() if name}
            yield from check_presence(machines, masters)
            yield from check_fitness(one, machines, masters)


def check_presence(
    machines: Mapping[str, MachineFacts], masters: Mapping[str, str]
) -> Iterator[Problem]:
    """Yield the machines without their interface."""
    missing = {
        node: f"{name} (there: {list_usable(machines[node]) or 'none'})"
        for node, name in masters.items()
        if name not in machines[node].interfaces
    }
    for text, nodes in group_by_text(missing).items():
        verb = "has" if len(nodes) == 1 else "have"
        yield INTERFACE_MISSING.problem(
            f"{list_some(nodes)} {verb} no interface {text}",
            "set `network.interface` to one that exists on every machine that pods may run on, or"
            " keep the pods away from the others with `placement`",
        )


def list_usable(facts: MachineFacts) -> str:
    """Return a machine's interfaces that an attachment may use."""
    names = sorted(name for name in facts.interfaces if not name.startswith(OTHERS))
    return list_some(
        (f"{n} (wireless)" if facts.interfaces[n].wireless else n for n in names), most=8
    )


def check_fitness(
    one: AttachmentFacts, machines: Mapping[str, MachineFacts], masters: Mapping[str, str]
) -> Iterator[Problem]:
    """Yield interfaces that cannot carry the attachment; machines with the same one together."""
    alike: dict[Interface, list[str]] = {}
    for node, name in masters.items():
        if name in machines[node].interfaces:
            alike.setdefault(machines[node].interfaces[name], []).append(node)
    for interface, nodes in alike.items():
        which = f"{interface.name} of {list_some(nodes)}"
        if interface.wireless and one.program == "macvlan":
            yield INTERFACE_WIRELESS.problem(
                f"{which} is wireless: access points drop packets from macvlan's additional MAC"
                " addresses",
                "use `mode: peers` or `discovery-server`, which need no second network",
            )
        if not interface.up:
            yield INTERFACE_DOWN.problem(
                f"{which} is down: pods would start and receive nothing",
                f"run `ip link set {interface.name} up` there, and change the machine's network"
                " configuration",
            )
        if one.mtu > interface.mtu:
            yield MTU.problem(
                f"the MTU {one.mtu} is larger than that of {which}, {interface.mtu}",
                f"set `network.mtu` to at most {interface.mtu}, or remove it",
            )


def check_addresses(case: Case) -> Iterator[Problem]:
    """Yield what an attachment's addresses collide with."""
    for one in case.attachments:
        for given in case.ranges(one):
            pods = [f"{s} ({node})" for node, s in case.pod_networks() if overlap(given, s)]
            if pods:
                yield describe_overlap(POD_NETWORK, given, f"the pod network: {list_some(pods)}")
            services = [subnet for subnet in case.view.services if overlap(given, subnet)]
            if services:
                what = f"the Services' network: {list_some(services)}"
                yield describe_overlap(SERVICE_NETWORK, given, what)
            owners, asked = case.owners(), case.list_asked_addresses(one)
            stolen = [
                f"{address} ({owners[address]})"
                for address in sorted(owners, key=int)
                if (address in asked if one.ipam == "static" else given.gives(address))
            ]
            if stolen:
                yield MACHINE_ADDRESS.problem(
                    f"pods would get addresses that machines have: {list_some(stolen)}",
                    "exclude them with `network.range_start`, `range_end` or `exclude`",
                )


def overlap(given: AddressRange, other: Subnet) -> bool:
    """Return whether a range's subnet overlaps another one."""
    return given.subnet.version == other.version and given.subnet.overlaps(other)


def describe_overlap(kind: PreflightKind, given: AddressRange, what: str) -> Problem:
    """Return the problem that a range overlaps one of the cluster's networks."""
    return kind.problem(
        f"subnet {given.subnet} overlaps {what}: pods would look for those on the second network",
        "set `network.subnet` to a range that nothing in the cluster uses",
    )


def check_room(case: Case) -> Iterator[Problem]:
    """Yield attachments whose addresses run out."""
    for one in case.attachments:
        pods, given = sum(pod.pods for pod in case.users(one)), case.ranges(one)
        if not given or one.ipam not in ("whereabouts", "static", "host-local"):
            continue
        least = min(given, key=lambda r: r.size)  # a pod gets one address of each range
        if pods > least.size:
            yield TOO_FEW_ADDRESSES.problem(
                f"{pods} pods need an address, and {least.subnet} has {least.size} to give out"
                f" ({least})",
                "use a larger `network.subnet`, or a larger range in `range_start` and `range_end`",
            )


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

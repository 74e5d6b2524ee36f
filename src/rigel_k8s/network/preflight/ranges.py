"""Checks whether a second network's addresses collide with others, and whether there are enough."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.network.preflight.attachments import Attachment, Range, subnet
from rigel_k8s.network.preflight.case import Case, addresses_of
from rigel_k8s.network.preflight.finding import PreflightKind, list_some
from rigel_k8s.network.preflight.machine import Address, Subnet
from rigel_k8s.problems import Problem

ATTACHMENT_ADDRESSES = PreflightKind(
    "attachment-addresses",
    "`ipam: static`, and the attachment assigns no requested addresses",
    "Rigelfile",
    "its configuration",
)
ROUTE = PreflightKind(
    "route",
    "a machine reaches a part of the subnet by another interface",
    "warning",
    "`/proc/net/route`",
)
MACHINE_ADDRESS = PreflightKind(
    "machine-address",
    "pods would get addresses of machines",
    "Rigelfile",
    "addresses of the nodes, from Kubernetes and from the machines",
)
GATEWAY_ADDRESS = PreflightKind(
    "gateway-address",
    "a pod would get the gateway's address (whereabouts assigns it)",
    "Rigelfile",
    "the attachment",
)
HOST_LOCAL = PreflightKind(
    "host-local",
    "host-local with several pods on several machines",
    "Rigelfile",
    "where the pods may run",
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

KEEP_OFF = "exclude them with `network.range_start`, `range_end` or `exclude`"


def ranges(case: Case) -> Iterator[Problem]:
    """Yield what an attachment's addresses collide with."""
    for one in case.attachments:
        for given in case.ranges(one):
            yield from _check_cluster_networks(case, given)
            yield from _check_other_interfaces(case, one, given)
            yield from _check_machines(case, one, given)
        yield from _check_asked(case, one)


def _check_asked(case: Case, one: Attachment) -> Iterator[Problem]:
    """Yield attachments that do not give pods the addresses that they request."""
    if not case.list_asked_addresses(one) or (one.ipam == "static" and one.passes):
        return
    if one.ipam != "static":
        why = f"it takes addresses from {one.ipam}" if one.ipam else "it has no `ipam`"
    else:
        why = '`"capabilities": {"ips": true}` is missing in its configuration'
    yield ATTACHMENT_ADDRESSES.problem(
        f"NetworkAttachmentDefinition {one.key} does not give pods the addresses that they request:"
        f" {why}",
        'use an attachment with `"ipam": {"type": "static"}` and `"capabilities": {"ips": true}`,'
        " or remove `ipam: static` from the Rigelfile",
    )


def _check_cluster_networks(case: Case, given: Range) -> Iterator[Problem]:
    pods = [f"{text} ({node})" for node, text in _pod_networks(case) if _overlap(given, text)]
    if pods:
        yield _overlapping(POD_NETWORK, given, f"the pod network: {list_some(pods)}")
    services = [str(text) for text in case.view.services if _overlap(given, text)]
    if services:
        yield _overlapping(SERVICE_NETWORK, given, f"the Services' network: {list_some(services)}")


def _overlapping(kind: PreflightKind, given: Range, what: str) -> Problem:
    return kind.problem(
        f"subnet {given.subnet} overlaps {what}: pods would look for those on the second network",
        "set `network.subnet` to a range that nothing in the cluster uses",
    )


def _pod_networks(case: Case) -> Iterator[tuple[str, Subnet]]:
    for node in case.view.nodes:
        spec = node.get("spec") or {}
        for text in spec.get("podCIDRs") or [spec.get("podCIDR")]:
            found = subnet(text) if text else None
            if found is not None:
                yield node["metadata"]["name"], found


def _overlap(given: Range, other: Subnet) -> bool:
    return given.subnet.version == other.version and given.subnet.overlaps(other)


def _check_other_interfaces(case: Case, one: Attachment, given: Range) -> Iterator[Problem]:
    """Yield ranges that machines reach elsewhere: pods would look for them on the second network.

    Routes to pods are left out: _check_cluster_networks reports them.
    """
    pods = [found for _, found in _pod_networks(case)]
    for node, facts in case.machines(one):
        master = one.master or facts.default_interface
        for route in facts.routes:
            length = route.subnet.prefixlen
            if route.interface == master or length in (0, route.subnet.max_prefixlen):
                continue
            if _overlap(given, route.subnet) and not any(_is_within(route.subnet, p) for p in pods):
                yield ROUTE.problem(
                    f"{node} reaches {route.subnet} through {route.interface}, and subnet"
                    f" {given.subnet} overlaps it: pods would look for it on {master}",
                    "use another `network.subnet`, unless both interfaces are on one segment",
                )


def _is_within(inner: Subnet, outer: Subnet) -> bool:
    return inner.version == outer.version and inner.subnet_of(outer)  # type: ignore[arg-type]


def _check_machines(case: Case, one: Attachment, given: Range) -> Iterator[Problem]:
    """Yield addresses of machines and of the gateway that pods would get."""
    asked = case.list_asked_addresses(one)
    owners = _owners(case)
    if one.ipam == "static":
        stolen = [f"{a} ({owners[a]})" for a in sorted(asked, key=int) if a in owners]
    else:
        stolen = [f"{a} ({owners[a]})" for a in sorted(owners, key=int) if given.gives(a)]
    if stolen:
        yield MACHINE_ADDRESS.problem(
            f"pods would get addresses that machines have: {list_some(stolen)}",
            KEEP_OFF,
        )
    if one.gateway and (given.gives(one.gateway) if one.ipam != "static" else one.gateway in asked):
        yield GATEWAY_ADDRESS.problem(
            f"a pod would get the gateway's address, {one.gateway}",
            KEEP_OFF,
        )


def _owners(case: Case) -> dict[Address, str]:
    """Return the addresses of machines, with the machine's name; those towards pods left out."""
    found: dict[Address, str] = {}
    for node, facts in case.view.machines.items():
        found |= dict.fromkeys(facts.addresses, node)
    for manifest in case.view.nodes:
        found |= addresses_of(manifest)
    pods = [network for _, network in _pod_networks(case)]
    return {one: node for one, node in found.items() if not any(one in n for n in pods)}


def room(case: Case) -> Iterator[Problem]:
    """Yield attachments whose addresses run out, and those that give two pods the same one."""
    for one in case.attachments:
        pods = case.pods(one)
        nodes = case.nodes(case.users(one))
        if one.ipam == "host-local" and pods > 1 and len(nodes) > 1:
            yield _host_local(nodes)
        given = case.ranges(one)
        if given and one.ipam in ("whereabouts", "static", "host-local"):
            yield from _check_room(given, pods)


def _host_local(nodes: list[str]) -> Problem:
    return HOST_LOCAL.problem(
        f"host-local gives out addresses on each machine independently, and pods may run on"
        f" {list_some(nodes)}: two of them would get the same address",
        "use `ipam: whereabouts`, or keep all pods on one machine with `placement.node`",
    )


def _check_room(given: tuple[Range, ...], pods: int) -> Iterator[Problem]:
    # A pod gets one address of each range, so the smallest range decides.
    least = min(given, key=lambda r: r.size)
    if pods > least.size:
        yield TOO_FEW_ADDRESSES.problem(
            f"{pods} pods need an address, and {least.subnet} has {least.size} to give out"
            f" ({least})",
            "use a larger `network.subnet`, or a larger range in `range_start` and `range_end`",
        )

"""What a release requests, and what was seen of the cluster: the input of every check."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import attrs

from rigel_k8s.network.options import Network
from rigel_k8s.network.preflight.attachments import Attachment, Range, address, find_usable, subnet
from rigel_k8s.network.preflight.daemon import Daemon
from rigel_k8s.network.preflight.machine import Address, MachineFacts, Subnet
from rigel_k8s.network.preflight.wanted import Wanted
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.scheduling import may_run

Manifest = Mapping[str, Any]


@attrs.frozen(kw_only=True)
class MachineView:
    """What was seen of a cluster.

    Attributes:
        multus: whether it has the kind NetworkAttachmentDefinition; whereabouts: the kind IPPool.
        daemons: by machine; None if they could not be listed.
        machines: facts by machine, of those that could be examined.
        attachments: those of the cluster, by NAMESPACE/NAME.
        unread: NAMESPACE/NAME of attachments that may exist, but could not be read.
        services: ranges of Services.
        policies: the NetworkPolicies of the release's namespace.
    """

    multus: bool = True
    whereabouts: bool = True
    nodes: Sequence[Manifest] = ()
    daemons: Mapping[str, Daemon] | None = attrs.field(factory=dict)
    machines: Mapping[str, MachineFacts] = attrs.field(factory=dict)
    attachments: Mapping[str, Attachment] = attrs.field(factory=dict)
    unread: frozenset[str] = frozenset()
    services: Sequence[Subnet] = ()
    policies: Sequence[Manifest] = ()


@attrs.define(slots=False)  # for cached properties; never changed
class Case:
    """A release's network, its pods and attachments, and the cluster as it was seen.

    Attributes:
        own: the attachments that are part of the release, by NAMESPACE/NAME.
    """

    network: Network
    wanted: Sequence[Wanted]
    own: Mapping[str, Attachment]
    view: MachineView = MachineView()

    @cached_property
    def keys(self) -> list[str]:
        """The attachments that pods request, by name."""
        return sorted({request.key for pod in self.wanted for request in pod.requests})

    @cached_property
    def ready(self) -> set[str]:
        """The machines that are ready."""
        return {node["metadata"]["name"] for node in self.view.nodes if is_ready(node)}

    @cached_property
    def attachments(self) -> list[Attachment]:
        """Those of them that exist, or are part of the release."""
        known = {**self.view.attachments, **self.own}
        return [known[key] for key in self.keys if key in known]

    def users(self, one: Attachment) -> list[Wanted]:
        """Return the workloads that request an attachment."""
        return [pod for pod in self.wanted if pod.requests_network(one.key)]

    def pods(self, one: Attachment) -> int:
        """Return how many pods request an attachment."""
        return sum(pod.pods for pod in self.users(one))

    def nodes(self, users: Sequence[Wanted] | None = None) -> list[str]:
        """Return the machines that workloads (default: all) may run on."""
        pods = [pod.spec for pod in (self.wanted if users is None else users) if pod.pods]
        fitting = (n for n in self.view.nodes if any(may_run(pod, n) for pod in pods))
        return sorted(node["metadata"]["name"] for node in fitting)

    def machines(self, one: Attachment) -> Iterator[tuple[str, MachineFacts]]:
        """Yield the machines that an attachment's pods may run on, as far as they were seen."""
        for node in self.nodes(self.users(one)):
            if node in self.view.machines:
                yield node, self.view.machines[node]

    def ranges(self, one: Attachment) -> tuple[Range, ...]:
        """Return which addresses an attachment gives out; static ones are in the Rigelfile."""
        if one.ranges or one.ipam != "static":
            return one.ranges
        whole = subnet(self.network.subnet) if self.network.subnet else None
        if whole is None:
            return ()
        first, last = find_usable(whole)
        exclude = tuple(s for s in map(subnet, self.network.exclude) if s is not None)
        first = address(self.network.range_start) or first
        return (Range(whole, first, address(self.network.range_end) or last, exclude),)

    def list_asked_addresses(self, one: Attachment) -> dict[Address, str]:
        """Return the single addresses that workloads request."""
        return {
            given: pod.workload
            for pod in self.users(one)
            for request in pod.requests
            if request.key == one.key
            for given in request.addresses
        }


def addresses_of(node: Manifest) -> dict[Address, str]:
    """Return the addresses of a machine in Kubernetes, with the machine's name."""
    listed = (node.get("status") or {}).get("addresses") or []
    found = (address(one.get("address")) for one in listed)
    return {one: node["metadata"]["name"] for one in found if one is not None}

"""What a release requests, and what was seen of the cluster: the input of every check."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import attrs

from rigel_k8s.network.options import Network
from rigel_k8s.objects.facts import is_ready
from rigel_k8s.objects.scheduling import may_run
from rigel_multus.interfaces import InterfaceRequest, list_requests
from rigel_multus.preflight.attachments import (
    AddressRange,
    AttachmentFacts,
    make_range,
    read_address,
    read_subnet,
)
from rigel_multus.preflight.machine import Address, Daemon, MachineFacts, Subnet

Manifest = Mapping[str, Any]


@attrs.frozen
class Wanted:
    """A workload whose pods request second networks.

    Attributes:
        pods: how many of them.
        spec: the pods' spec, which decides where they may run.
    """

    workload: str
    requests: Sequence[InterfaceRequest]
    pods: int = 1
    spec: Manifest = attrs.field(factory=dict)

    def requests_network(self, key: str) -> bool:
        """Return whether its pods request this attachment."""
        return any(request.key == key for request in self.requests)


def find_wanted(objects: Iterable[Manifest]) -> Iterator[Wanted]:
    """Yield the workloads that request an attachment, or the machine's own network."""
    for item in objects:
        meta, spec = item["metadata"], item.get("spec") or {}
        template = spec.get("template") or {}
        pod = template.get("spec") or {}
        annotations = (template.get("metadata") or {}).get("annotations") or {}
        requests = list_requests(annotations, meta.get("namespace", ""))
        if requests or pod.get("hostNetwork"):
            replicas = spec.get("replicas")
            yield Wanted(meta["name"], requests, 1 if replicas is None else int(replicas), pod)


@attrs.frozen(kw_only=True)
class ClusterView:
    """What was seen of a cluster.

    Attributes:
        multus: whether it has the kind NetworkAttachmentDefinition; whereabouts: the kind IPPool.
        daemons: by machine; None if they could not be listed.
        machines: facts by machine, of those that could be examined.
        attachments: those of the cluster, by NAMESPACE/NAME.
        unread: NAMESPACE/NAME of attachments that may exist, but could not be read.
        services: ranges of Services.
    """

    multus: bool = True
    whereabouts: bool = True
    nodes: Sequence[Manifest] = ()
    daemons: Mapping[str, Daemon] | None = attrs.field(factory=dict)
    machines: Mapping[str, MachineFacts] = attrs.field(factory=dict)
    attachments: Mapping[str, AttachmentFacts] = attrs.field(factory=dict)
    unread: frozenset[str] = frozenset()
    services: Sequence[Subnet] = ()


@attrs.define(slots=False)  # for cached properties; never changed
class Case:
    """A release's network, its pods and attachments, and the cluster as it was seen.

    Attributes:
        own: the attachments that are part of the release, by NAMESPACE/NAME.
    """

    network: Network
    wanted: Sequence[Wanted]
    own: Mapping[str, AttachmentFacts]
    view: ClusterView = ClusterView()

    @cached_property
    def keys(self) -> list[str]:
        """The attachments that pods request, by name."""
        return sorted({request.key for pod in self.wanted for request in pod.requests})

    @cached_property
    def ready(self) -> set[str]:
        return {node["metadata"]["name"] for node in self.view.nodes if is_ready(node)}

    @cached_property
    def attachments(self) -> list[AttachmentFacts]:
        """Those of them that exist, or are part of the release."""
        known = {**self.view.attachments, **self.own}
        return [known[key] for key in self.keys if key in known]

    def users(self, one: AttachmentFacts) -> list[Wanted]:
        """Return the workloads that request an attachment."""
        return [pod for pod in self.wanted if pod.requests_network(one.key)]

    def nodes(self, users: Sequence[Wanted] | None = None) -> list[str]:
        """Return the machines that workloads (default: all) may run on."""
        pods = [pod.spec for pod in (self.wanted if users is None else users) if pod.pods]
        fitting = (n for n in self.view.nodes if any(may_run(pod, n) for pod in pods))
        return sorted(node["metadata"]["name"] for node in fitting)

    def machines(self, one: AttachmentFacts | None = None) -> dict[str, MachineFacts]:
        """Return the machines that pods (default: all) may run on, as far as they were seen."""
        nodes = self.nodes(None if one is None else self.users(one))
        return {node: self.view.machines[node] for node in nodes if node in self.view.machines}

    def ranges(self, one: AttachmentFacts) -> Sequence[AddressRange]:
        """Return which addresses an attachment gives out; static ones are in the Rigelfile."""
        if one.ranges or one.ipam != "static":
            return one.ranges
        network = self.network
        made = make_range(
            network.subnet or "", network.range_start, network.range_end, network.exclude
        )
        return (made,) if made else ()

    def list_asked_addresses(self, one: AttachmentFacts) -> set[Address]:
        """Return the single addresses that workloads request."""
        requests = [r for pod in self.wanted for r in pod.requests if r.key == one.key]
        found = (read_address(text) for request in requests for text in request.addresses)
        return {address for address in found if address is not None}

    def pod_networks(self) -> list[tuple[str, Subnet]]:
        """Return the ranges of the pods' own network, each with its machine."""
        found = []
        for node in self.view.nodes:
            spec = node.get("spec") or {}
            for text in spec.get("podCIDRs") or [spec.get("podCIDR")]:
                subnet = read_subnet(text)
                if subnet is not None:
                    found.append((node["metadata"]["name"], subnet))
        return found

    def owners(self) -> dict[Address, str]:
        """Return the addresses of machines, with its name; without those towards pods."""
        found: dict[Address, str] = {}
        for name, facts in self.view.machines.items():
            found |= dict.fromkeys(facts.addresses, name)
        for node in self.view.nodes:
            for one in (node.get("status") or {}).get("addresses") or []:
                address = read_address(one.get("address"))
                if address is not None:
                    found[address] = node["metadata"]["name"]
        pods = [subnet for _, subnet in self.pod_networks()]
        return {one: name for one, name in found.items() if not any(one in pod for pod in pods)}

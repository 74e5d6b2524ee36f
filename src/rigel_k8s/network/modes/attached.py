"""Modes with a second interface by Multus: macvlan, and an existing attachment."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from ipaddress import IPv4Address, IPv4Network
from typing import Any, ClassVar

import attrs

from rigel_k8s.network.addresses import Pool
from rigel_k8s.network.dds import pinned_files, pinned_variables, shares_memory, uses
from rigel_k8s.network.files import (
    SCRIPT,
    files_config,
    interface_script,
    make_context,
    render_at_start,
)
from rigel_k8s.network.mode import Mode, ModeUse, mode_path
from rigel_k8s.network.options import INTERFACE, Network
from rigel_k8s.network.wiring import (
    NETWORKS_ANNOTATION,
    NetworkPlan,
    PodIdentity,
    Wiring,
    network_note,
)
from rigel_k8s.objects.pods import MASTER_NAME, MASTER_PORT, Object, drop_empty
from rigel_k8s.problems import Problem

#: Every plugin in use supports it; newer versions add nothing that an attachment needs.
CNI_VERSION = "0.3.1"
#: NAME or NAMESPACE/NAME of an attachment.
REFERENCE = re.compile(r"([a-z0-9]([-a-z0-9]*[a-z0-9])?/)?[a-z0-9]([-a-z0-9.]*[a-z0-9])?")


def attachment_name(plan: NetworkPlan) -> tuple[str, str]:
    """Return (namespace, name) of the NetworkAttachmentDefinition."""
    given = plan.options.attachment if plan.options else None
    if not given:
        return plan.namespace, f"{plan.release}-{INTERFACE}"
    namespace, slash, name = given.rpartition("/")
    return (namespace if slash else plan.namespace), name


def definition(plan: NetworkPlan, network: Network) -> Object:
    """Return the NetworkAttachmentDefinition; its configuration is JSON in a text."""
    _, name = attachment_name(plan)
    return {
        "apiVersion": "k8s.cni.cncf.io/v1",
        "kind": "NetworkAttachmentDefinition",
        "metadata": make_context(plan).metadata(name, part_of=plan.release),
        "spec": {"config": json.dumps(plugin(name, network))},
    }


def plugin(name: str, network: Network) -> dict[str, Any]:
    """Return the configuration of the macvlan plugin."""
    static = {"capabilities": {"ips": True}} if network.ipam == "static" else {}
    return drop_empty(
        {
            "cniVersion": CNI_VERSION,
            "name": name,
            "type": network.mode,
            "master": network.interface,
            "mode": "bridge",
            "mtu": network.mtu and int(network.mtu),
            **static,
            "ipam": ipam(network),
        }
    )


def ipam(network: Network) -> dict[str, Any]:
    """Return the program that gives out addresses, and which addresses it has."""
    routes = {"routes": [drop_empty({"dst": to, "gw": network.gateway}) for to in network.routes]}
    kind = network.ipam or "whereabouts"
    if kind == "whereabouts":
        return drop_empty({"type": kind, **whereabouts_range(network), **routes})
    if kind == "host-local":
        return drop_empty({"type": kind, "ranges": [host_local_ranges(network)], **routes})
    return drop_empty({"type": kind, **routes})


def whereabouts_range(network: Network) -> dict[str, Any]:
    """Return the range as whereabouts reads it."""
    never = [item if "/" in item else f"{item}/32" for item in list_excluded(network)]
    return {
        "range": str(IPv4Network(network.subnet or "", strict=False)),
        "range_start": network.range_start,
        "range_end": network.range_end,
        "exclude": never,
        "gateway": network.gateway,
    }


def list_excluded(network: Network) -> list[str]:
    """Return what is not given out; a gateway has its address already."""
    return [*network.exclude, *([network.gateway] if network.gateway else [])]


def host_local_ranges(network: Network) -> list[dict[str, Any]]:
    """Return the ranges as host-local reads them: several ranges, since it has no exclusions."""
    pool = Pool(network)
    return [
        drop_empty(
            {
                "subnet": str(pool.subnet),
                "rangeStart": str(IPv4Address(first)),
                "rangeEnd": str(IPv4Address(last)),
                "gateway": network.gateway,
            }
        )
        for first, last in pool.stretches
    ]


def selection(plan: NetworkPlan, pod: PodIdentity) -> str:
    """Return Multus' annotation: the attachment, the interface and the address of a pod."""
    namespace, name = attachment_name(plan)
    address = plan.addresses.get(pod.name)
    chosen = {"name": name, "namespace": namespace, "interface": INTERFACE}
    return json.dumps([chosen | ({"ips": [address]} if address else {})])


def note(plan: NetworkPlan, pod: PodIdentity, network: Network, *, own: bool) -> dict[str, str]:
    """Return the annotation that describes how a pod is networked.

    A pod keeps the interface that it got, so another configuration must start another pod.

    Args:
        own: the attachment is made here, so its configuration is known.
    """
    text = json.dumps(plugin("", network)) if own else ""
    mark = hashlib.sha256(text.encode()).hexdigest()[:8] if own else None
    address = plan.addresses.get(pod.name, "").partition("/")[0] or None
    shared = shares_memory(plan, pod, pinned=True)
    return network_note(
        plan, interface=INTERFACE, address=address, config=mark, shared_memory=shared
    )


def variables(plan: NetworkPlan, pod: PodIdentity) -> dict[str, Object]:
    """Return the variables that pin a pod's ROS or DDS to the second network."""
    return pinned_variables(plan, pod) if plan.ros.dds else master_variables(plan, pod)


def master_variables(plan: NetworkPlan, pod: PodIdentity) -> dict[str, Object]:
    """Return the variables with ROS 1's addresses; roscore's own pod needs no master's address."""
    own, master = (
        plan.addresses.get(name, "").partition("/")[0] for name in (pod.name, MASTER_NAME)
    )
    found = {"ROS_IP": {"value": own}} if own else {}
    if master and pod.name != MASTER_NAME:
        found["ROS_MASTER_URI"] = {"value": f"http://{master}:{MASTER_PORT}"}
    return found


RANGES = frozenset({"subnet", "ipam", "range_start", "range_end", "exclude", "install"})


class Macvlan(Mode):
    """A second interface that is made here.

    Attributes:
        makes_attachment: the NetworkAttachmentDefinition is not one that exists.
    """

    name = "macvlan"
    keys = RANGES | {"interface", "gateway", "routes", "mtu"}
    with_master = True
    attached = True
    on_machines = True
    makes_attachment: ClassVar[bool] = True

    def objects(self, plan: NetworkPlan, network: Network) -> Iterator[Object]:
        """Yield the attachment, unless it exists already, and the files that pods read."""
        if self.makes_attachment:
            yield definition(plan, network)
        yield files_config(plan, {SCRIPT: interface_script(), **pinned_files(plan, INTERFACE)})

    def wire(self, plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
        """Return what a pod on the second network gets."""
        namespace, name = attachment_name(plan)
        missing = (
            f"{INTERFACE} is missing: Multus did not attach {namespace}/{name} to this pod;"
            " check that Multus runs on its machine, then delete the pod: a new one gets it"
        )
        made = render_at_start(plan, pod, INTERFACE, missing, own_machine_id=uses(plan, "fastdds"))
        return attrs.evolve(
            made,
            env=variables(plan, pod),
            annotations={
                NETWORKS_ANNOTATION: selection(plan, pod),
                **note(plan, pod, network, own=self.makes_attachment),
            },
        )

    def check(self, network: Network, use: ModeUse) -> Iterator[Problem]:
        """Yield required keys that are missing, and an IPAM that the mode does not support."""
        own = self.makes_attachment
        ranged = own or network.ipam == "static"
        needed = {
            "interface": (own, "the machines' interface, such as eth0"),
            "subnet": (ranged, "the addresses to give out"),
            "attachment": (not own, "NAME or NAMESPACE/NAME of an existing one"),
        }
        for key, (is_needed, what) in needed.items():
            if is_needed and getattr(network, key) is None:
                message = f"{network.mode} needs `{key}`: {what}"
                yield Problem(("network",), message, "incomplete", at_key=True)
        if network.attachment is not None and not REFERENCE.fullmatch(network.attachment):
            message = f'"{network.attachment}" is neither NAME nor NAMESPACE/NAME'
            yield Problem(("network", "attachment"), message, "bad-name")
        if not own and network.ipam not in (None, "static"):
            message = "the existing attachment decides who gives out addresses: leave it out"
            yield Problem(("network", "ipam"), message, "foreign-key", at_key=True)
        if not use.ros.dds and network.ipam != "static":
            message = (
                f"a {use.ros.title} node sends its address to the others, so it must be known"
                " before the node starts: set `ipam: static` and `subnet`"
            )
            path = ("network", "ipam") if network.ipam else mode_path(network)
            yield Problem(path, message, "ros1")

    def join(self, plan: NetworkPlan, network: Network) -> dict[str, Any]:
        """Return the second interface."""
        return {"interface": INTERFACE}

    def interface(self, network: Network) -> str | None:
        return INTERFACE


class Attachment(Macvlan):
    """A second interface by an attachment that exists."""

    name = "attachment"
    keys = RANGES | {"attachment"}
    makes_attachment = False

    def explain_unused(self, network: Network) -> str | None:
        """Return why the options about addresses have no effect."""
        if network.ipam == "static":
            return None
        return (
            "the existing attachment decides about addresses; this has an effect only with"
            " `ipam: static`"
        )


MACVLAN = Macvlan()
ATTACHMENT = Attachment()

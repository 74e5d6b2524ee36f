"""What each kind of the preflight's findings means; docs/errors.md is generated from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import attrs

from rigel_k8s.kinds import Kind


@attrs.frozen
class PreflightKind(Kind):
    """A kind of finding.

    Attributes:
        changes: who has to change something: the Rigelfile (exit code 2), the cluster (exit
            code 1), or no one, since it is a warning.
        found_by: where the answer comes from.
    """

    changes: Literal["Rigelfile", "cluster", "warning"]
    found_by: str


INSTALL = "`network: {install: true}`, or `rigel network install`"

MULTUS: Mapping[str, PreflightKind] = {
    "multus-missing": PreflightKind(
        "the cluster has no NetworkAttachmentDefinition",
        INSTALL,
        "cluster",
        "the kinds of the API",
    ),
    "whereabouts-missing": PreflightKind(
        "`ipam: whereabouts`, and the cluster has no IPPool",
        f"{INSTALL}, or another `ipam`",
        "cluster",
        "the kinds of the API",
    ),
    "multus-not-on-node": PreflightKind(
        "a machine has no Multus daemon",
        f"{INSTALL}, or `placement`",
        "cluster",
        "pods of DaemonSets with Multus' image or name",
    ),
    "multus-not-ready": PreflightKind(
        "a machine's daemon is not ready, so pods would start without net1",
        "read its log; the message has the command",
        "cluster",
        "the pod's conditions",
    ),
    "program-missing": PreflightKind(
        "a machine has no program macvlan, whereabouts, static or the like",
        "[`install: true`](multus.md) for those that it brings, otherwise an image with them",
        "cluster",
        "the directory of CNI programs on the machine",
    ),
    "kernel": PreflightKind(
        "the kernel was built without macvlan or ipvlan",
        "use another kernel or mode",
        "cluster",
        "`/proc/config.gz`, if the kernel has it",
    ),
    "dhcp-daemon": PreflightKind(
        "`ipam: dhcp`, and no process listens at `/run/cni/dhcp.sock`",
        "`network: {install: true}`, `rigel network install --dhcp`, or whereabouts",
        "cluster",
        "the machine's socket",
    ),
    "attachment-missing": PreflightKind(
        "the named attachment does not exist",
        "correct its name",
        "Rigelfile",
        "NetworkAttachmentDefinitions of all namespaces",
    ),
    "attachment-addresses": PreflightKind(
        "`ipam: static`, and the attachment assigns no requested addresses",
        "use another attachment, or another `ipam`",
        "Rigelfile",
        "its configuration",
    ),
}

INTERFACES: Mapping[str, PreflightKind] = {
    "interface-missing": PreflightKind(
        "a machine does not have this interface; the message lists those that it has",
        "correct `network.interface`, or set `placement`",
        "Rigelfile",
        "`/sys/class/net`",
    ),
    "interface-unsaid": PreflightKind(
        "no interface is set, and the machine has no default route",
        "set `network.interface`",
        "Rigelfile",
        "`/proc/net/route`",
    ),
    "interface-wireless": PreflightKind(
        "macvlan over Wi-Fi: access points drop further MAC addresses",
        "use `ipvlan`, `peers` or `discovery-server`",
        "Rigelfile",
        "`wireless` or `phy80211` in `/sys/class/net/NAME`, or `DEVTYPE=wlan`",
    ),
    "interface-not-ethernet": PreflightKind(
        "macvlan over a tunnel, a loopback interface or the like",
        "use another interface",
        "Rigelfile",
        "`/sys/class/net/NAME/type`",
    ),
    "interface-port": PreflightKind(
        "the interface is a port of a bridge or a bond, which takes all that arrives",
        "use the bridge, for example `interface: br0`",
        "Rigelfile",
        "interfaces on top of it",
    ),
    "interface-down": PreflightKind(
        "the interface is switched off",
        "`ip link set NAME up`",
        "cluster",
        "`/sys/class/net/NAME/flags`",
    ),
    "interface-no-carrier": PreflightKind(
        "no cable is plugged in",
        "plug it in",
        "warning",
        "`/sys/class/net/NAME/operstate`",
    ),
    "mtu": PreflightKind(
        "`network.mtu` is larger than that of the interface",
        "use a smaller one",
        "Rigelfile",
        "`/sys/class/net/NAME/mtu`",
    ),
}

ADDRESSES: Mapping[str, PreflightKind] = {
    "pod-network": PreflightKind(
        "the subnet overlaps that of the pods",
        "use another subnet",
        "Rigelfile",
        "`podCIDRs` of all nodes",
    ),
    "service-network": PreflightKind(
        "the subnet overlaps that of the Services",
        "use another subnet",
        "Rigelfile",
        "ServiceCIDRs (Kubernetes 1.33 and newer), the Service `kubernetes`",
    ),
    "machine-address": PreflightKind(
        "pods would get addresses of machines",
        "set `range_start`, `range_end` or `exclude`",
        "Rigelfile",
        "addresses of the nodes, from Kubernetes and from the machines",
    ),
    "gateway-address": PreflightKind(
        "a pod would get the gateway's address (whereabouts assigns it)",
        "add it to `exclude`",
        "Rigelfile",
        "the attachment",
    ),
    "route": PreflightKind(
        "a machine reaches a part of the subnet by another interface",
        "use another subnet",
        "warning",
        "`/proc/net/route`",
    ),
    "host-local": PreflightKind(
        "host-local with several pods on several machines",
        "use whereabouts, or set `placement.node`",
        "Rigelfile",
        "where the pods may run",
    ),
    "too-few-addresses": PreflightKind(
        "there are more pods than addresses (`static`, `whereabouts`, `host-local`)",
        "use a larger range",
        "Rigelfile",
        "counting",
    ),
}

LIMITS: Mapping[str, PreflightKind] = {
    "network-policy": PreflightKind(
        "a NetworkPolicy selects pods of the release, and does not cover the second interface (nor"
        " `host`)",
        "use a VLAN, a firewall or a MultiNetworkPolicy",
        "warning",
        "NetworkPolicies of the namespace",
    ),
    "unseen": PreflightKind(
        "something could not be examined",
        "the message says why; often a right is missing",
        "warning",
        "",
    ),
}

#: All kinds, by the title of a group.
PREFLIGHT: Mapping[str, Mapping[str, PreflightKind]] = {
    "Multus and its programs": MULTUS,
    "Interfaces": INTERFACES,
    "Addresses": ADDRESSES,
    "Policies, and what was not examined": LIMITS,
}

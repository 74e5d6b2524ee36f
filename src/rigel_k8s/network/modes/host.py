"""Mode `host`: the machine's own network, for a robot that is one machine."""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.network.dds import pinned_files, pinned_variables, uses
from rigel_k8s.network.files import SCRIPT, files_config, interface_script, render_at_start
from rigel_k8s.network.mode import Mode
from rigel_k8s.network.neighbors import neighbor_files, wire_neighbor
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.pods import Object

#: The cluster's names, on the machine's own network too.
ON_HOST = {"hostNetwork": True, "dnsPolicy": "ClusterFirstWithHostNet"}
HOST_IP = {"valueFrom": {"fieldRef": {"apiVersion": "v1", "fieldPath": "status.hostIP"}}}


def objects(plan: NetworkPlan, network: Network) -> Iterator[Object]:
    """Yield the files that pods read, if they need any."""
    if network.interface and plan.ros.dds:
        pinned = pinned_files(plan, network.interface)
        yield files_config(plan, {SCRIPT: interface_script(), **pinned})
    else:
        yield from neighbor_files(plan)


def wire(plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
    """Return what a pod on the machine's network gets."""
    interface = network.interface if plan.ros.dds else None
    if interface:
        missing = f"{interface} is missing: this machine has no such interface (network.interface)"
        base = render_at_start(plan, pod, interface, missing, own_machine_id=uses(plan, "fastdds"))
        base = attrs.evolve(base, env=pinned_variables(plan))
    elif not plan.ros.dds:
        base = Wiring(env={"ROS_IP": HOST_IP})
    else:
        base = wire_neighbor(plan)
    return attrs.evolve(base, annotations=network_note(plan, interface=interface), pod=ON_HOST)


HOST = Mode(
    name="host",
    wire=wire,
    objects=objects,
    join=lambda plan, network: {"interface": network.interface},
    interface=lambda network: network.interface,
    keys=frozenset({"interface"}),
    with_master=True,
    on_machines=True,
    multicast=True,
    answers=True,
)

"""Mode `host`: the machine's own network, for a robot that is one machine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import attrs

from rigel_k8s.network.dds import (
    is_fastdds_2,
    pinned_files,
    pinned_variables,
    shares_memory,
    uses,
)
from rigel_k8s.network.files import (
    SCRIPT,
    files_config,
    interface_script,
    neighbor_files,
    render_at_start,
    wire_neighbor,
)
from rigel_k8s.network.mode import Mode, ModeUse
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Problem

#: The machine's /dev/shm, too.
SHARED = {"hostIPC": True}
#: The cluster's names, on the machine's own network too.
ON_HOST = {"hostNetwork": True, "dnsPolicy": "ClusterFirstWithHostNet"}
HOST_IP = {"valueFrom": {"fieldRef": {"apiVersion": "v1", "fieldPath": "status.hostIP"}}}


class Host(Mode):
    """The machine's own network."""

    name = "host"
    keys = frozenset({"interface", "shared_memory"})
    with_master = True
    on_machines = True
    sets_transports = True

    def objects(self, plan: NetworkPlan, network: Network) -> Iterator[Object]:
        """Yield the files that pods read, if they need any."""
        if network.interface and plan.ros.dds:
            pinned = pinned_files(plan, network.interface)
            yield files_config(plan, {SCRIPT: interface_script(), **pinned})
        else:
            yield from neighbor_files(plan)

    def wire(self, plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
        """Return what a pod on the machine's network gets."""
        interface = network.interface if plan.ros.dds else None
        if interface:
            missing = (
                f"{interface} is missing: this machine has no such interface (network.interface)"
            )
            base = render_at_start(
                plan, pod, interface, missing, own_machine_id=uses(plan, "fastdds")
            )
            base = attrs.evolve(base, env=pinned_variables(plan, pod))
        elif not plan.ros.dds:
            base = Wiring(env={"ROS_IP": HOST_IP})
        else:
            base = wire_neighbor(plan, pod)
        shared = shares_memory(plan, pod, pinned=interface is not None)
        note = network_note(plan, interface=interface, shared_memory=shared)
        return attrs.evolve(
            base, annotations=note, pod=ON_HOST | (SHARED if network.shared_memory else {})
        )

    def check(self, network: Network, use: ModeUse) -> Iterator[Problem]:
        """Yield shared memory for programs that would not use it."""
        path = ("network", "shared_memory")
        if network.shared_memory and not use.ros.dds:
            message = f"shared memory is for Fast DDS, and {use.ros.title} has no DDS: leave it out"
            yield Problem(path, message, "ros1", at_key=True)
        elif network.shared_memory and use.middleware not in (None, "fastdds"):
            message = (
                f"shared memory is for Fast DDS; {use.middleware} does not use it: leave it out"
            )
            yield Problem(path, message, "wrong-mode", at_key=True)
        elif network.shared_memory and network.interface and not is_fastdds_2(use.distro):
            message = (
                "from kilted on, Fast DDS does not share memory if it is pinned to an interface:"
                " leave out `interface`, or `shared_memory`"
            )
            yield Problem(path, message, "conflict", at_key=True)

    def join(self, plan: NetworkPlan, network: Network) -> dict[str, Any]:
        """Return the interface of the machine."""
        return {"interface": network.interface}

    def interface(self, network: Network) -> str | None:
        """Return the interface that the options name."""
        return network.interface


HOST = Host()

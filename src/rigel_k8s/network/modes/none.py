"""Mode `none`, as without `network`: the cluster's own network; an annotation shows the ROS.

Only nodes with `host_network` get anything: several of them may run on one machine.
"""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.network.mode import Mode
from rigel_k8s.network.neighbors import neighbor_files, wire_neighbor
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.pods import Object


def objects(plan: NetworkPlan, network: Network) -> Iterator[Object]:
    """Yield the file of nodes with `host_network`, if they need it."""
    if any(pod.on_machine for pod in plan.pods):
        yield from neighbor_files(plan)


def wire(plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
    """Return the annotation of a pod; one of nodes with a master has none."""
    if not plan.ros.dds:
        return Wiring()
    base = wire_neighbor(plan) if pod.on_machine else Wiring()
    return attrs.evolve(base, annotations=network_note(plan))


NONE = Mode(
    name="none",
    wire=wire,
    objects=objects,
    with_master=True,
    multicast=True,
    answers=True,
    looks_beyond=False,
)

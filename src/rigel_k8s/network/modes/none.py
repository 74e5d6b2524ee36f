"""Mode `none`, as without `network`: the cluster's own network; an annotation shows the ROS.

Only pods with the machine's network get anything, since several of them may run on one machine, and
pods that share memory.
"""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.network.dds import shares_memory
from rigel_k8s.network.mode import Mode
from rigel_k8s.network.neighbors import neighbor_files, wire_neighbor
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.pods import Object


def objects(plan: NetworkPlan, network: Network) -> Iterator[Object]:
    """Yield the file of the pods with transports of their own, if they need it."""
    if any(pod.on_machine or pod.shares_memory for pod in plan.pods):
        yield from neighbor_files(plan)


def wire(plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
    """Return the annotation of a pod; one of nodes with a master has none."""
    if not plan.ros.dds:
        return Wiring()
    apart = pod.on_machine or pod.shares_memory
    base = wire_neighbor(plan, pod) if apart else Wiring()
    return attrs.evolve(
        base, annotations=network_note(plan, shared_memory=shares_memory(plan, pod))
    )


NONE = Mode(
    name="none",
    wire=wire,
    objects=objects,
    with_master=True,
    looks_beyond=False,
)

"""Mode `none`, as without `network`: the cluster's own network; an annotation shows the ROS.

Only pods with the machine's network get anything, since several of them may run on one machine, and
pods that share memory.
"""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.network.dds import shares_memory
from rigel_k8s.network.files import neighbor_files, wire_neighbor
from rigel_k8s.network.mode import Mode
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.pods import Object

SET_NETWORK = (
    "a pod network usually carries no multicast: set `network` to macvlan if the machines share"
    " an Ethernet, otherwise peers or discovery-server, host on a single machine"
)


class NoNetwork(Mode):
    """The cluster's own network, as it is."""

    name = "none"
    with_master = True
    connects = False
    looks_beyond = False
    remedy = SET_NETWORK

    def wire(self, plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
        """Return the annotation of a pod; one of nodes with a master has none."""
        if not plan.ros.dds:
            return Wiring()
        apart = pod.on_machine or pod.shares_memory
        base = wire_neighbor(plan, pod) if apart else Wiring()
        return attrs.evolve(
            base, annotations=network_note(plan, shared_memory=shares_memory(plan, pod))
        )

    def objects(self, plan: NetworkPlan, network: Network) -> Iterator[Object]:
        """Yield the file of the pods with transports of their own, if they need it."""
        if any(pod.on_machine or pod.shares_memory for pod in plan.pods):
            yield from neighbor_files(plan)


NONE = NoNetwork()

"""Mode `none`: nothing is done, as without `network`; pods only say which ROS is in them."""

from __future__ import annotations

from rigel_k8s.network.mode import Mode
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note


def wire(plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
    """Return what a pod gets that nobody wires: a ROS 1 pod nothing at all."""
    return Wiring() if plan.ros == "1" else Wiring(annotations=network_note(plan))


NONE = Mode(
    name="none",
    wire=wire,
    ros=frozenset({"1", "2", "none"}),
    multicast=True,
    answers=True,
    looks_beyond=False,
)

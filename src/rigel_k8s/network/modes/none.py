"""Mode `none`: nothing is done, as without `network`; an annotation shows which ROS a pod has."""

from __future__ import annotations

from rigel_k8s.network.mode import Mode
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note


def wire(plan: NetworkPlan, pod: PodIdentity, network: Network) -> Wiring:
    """Return the annotation of a pod; a ROS 1 pod has none."""
    return Wiring() if plan.ros == "1" else Wiring(annotations=network_note(plan))


NONE = Mode(
    name="none",
    wire=wire,
    ros=frozenset({"1", "2", "none"}),
    multicast=True,
    answers=True,
    looks_beyond=False,
)

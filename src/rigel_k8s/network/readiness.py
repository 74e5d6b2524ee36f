"""What the readiness probe of a networked pod asks; docs/in-pod-scripts.md has its contract."""

from __future__ import annotations

from rigel_k8s.network.options import INTERFACE
from rigel_k8s.network.servers import ZENOH_PORT
from rigel_k8s.network.wiring import NetworkPlan

__all__ = ["ready_words"]

#: Modes whose pods are not ready without their second interface.
PINNED = frozenset({"macvlan", "ipvlan", "attachment"})


def ready_words(plan: NetworkPlan) -> tuple[str, ...]:
    """Return the script's arguments: about ROS 1 nodes, about zenoh's router, or about DDS."""
    if plan.ros == "1":
        return ("node",)
    if plan.middleware == "zenoh":
        return ("zenoh", "--port", str(ZENOH_PORT))
    interface = ("--interface", INTERFACE) if plan.mode in PINNED else ()
    domain = () if plan.domain_id is None else ("--domain", str(plan.domain_id))
    return ("dds", *domain, *interface)

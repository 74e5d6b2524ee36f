"""What the readiness probe of a networked pod asks; docs/in-pod-scripts.md has its contract."""

from __future__ import annotations

from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import INTERFACE, ZENOH_PORT
from rigel_k8s.network.wiring import NetworkPlan


def ready_words(plan: NetworkPlan, *, lifecycle: str | None = None) -> tuple[str, ...]:
    """Return the script's arguments: about ROS 1 nodes, about zenoh's router, or about DDS.

    Args:
        lifecycle: the full ROS name of a lifecycle node that is handed over.
    """
    if plan.ros == "1":
        return ("node",)
    if plan.middleware == "zenoh":
        return ("zenoh", "--port", str(ZENOH_PORT))
    interface = ("--interface", INTERFACE) if mode_of(plan.options).attached else ()
    domain = () if plan.domain_id is None else ("--domain", str(plan.domain_id))
    hands_over = ("--lifecycle", lifecycle) if lifecycle else ()
    return ("dds", *domain, *interface, *hands_over)

"""What the readiness probe of a networked pod checks; rigel_inpod/README.md has its contract."""

from __future__ import annotations

from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import INTERFACE, ZENOH_PORT
from rigel_k8s.network.wiring import NetworkPlan


def ready_words(plan: NetworkPlan) -> tuple[str, ...]:
    """Return the script's arguments: about zenoh's router, or about DDS."""
    if plan.middleware == "zenoh":
        return ("zenoh", "--port", str(ZENOH_PORT))
    interface = ("--interface", INTERFACE) if mode_of(plan.options).attached else ()
    domain = () if plan.domain_id is None else ("--domain", str(plan.domain_id))
    return ("dds", *domain, *interface)

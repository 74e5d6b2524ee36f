"""The network modes, one module each; a new one is a module, a line here and a word in options.py.

Code that wires pods uses this package and does not depend on single modes. A mode's module is
imported on its first use.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import attrs

from rigel_k8s.network.dds import EARLY
from rigel_k8s.network.mode import Mode
from rigel_k8s.network.options import INTERFACE, MIDDLEWARE, ZENOH_PORT, Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Path
from rigel_k8s.system.lazily import Lazily

__all__ = ["MODES", "join", "mode_of", "network_objects", "ready_words", "wire_pod"]

#: The modes by name, in the order of the documentation.
MODES: Mapping[str, Mode] = Lazily(
    {
        name: f"{__name__}.{home}"
        for name, home in {
            "macvlan": "attached:MACVLAN",
            "attachment": "attached:ATTACHMENT",
            "peers": "peers:PEERS",
            "discovery-server": "discovery_server:DISCOVERY_SERVER",
            "zenoh": "zenoh:ZENOH",
            "host": "host:HOST",
            "none": "none:NONE",
        }.items()
    }
)

BEFORE_IRON = EARLY - {"iron"}
#: Nodes discover others beyond their own machine, even if an image sets something else. LOCALHOST
#: with peers would try more ports of each and use shared memory again.
RANGE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": {"value": "SUBNET"}}
#: The same before iron.
OLD_RANGE = {"ROS_LOCALHOST_ONLY": {"value": "0"}}


#: What holds for a Rigelfile without `network`.
NO_NETWORK = Network(mode="none")


def mode_of(network: Network | None) -> Mode:
    """Return the mode of a network; mode none if there is no network."""
    return MODES[(network or NO_NETWORK).mode]


def mode_named(name: str) -> Mode:
    """Return the mode that a pod's annotation names; mode none for one of a later version."""
    return MODES.get(name) or MODES["none"]


def wire_pod(plan: NetworkPlan, pod: PodIdentity) -> Wiring:
    """Return what the release's network adds to one pod."""
    made = mode_of(plan.options).wire(plan, pod, plan.options or NO_NETWORK)
    return attrs.evolve(made, env=ros_variables(plan) | dict(made.env))


def network_objects(plan: NetworkPlan) -> Iterator[tuple[Path, Object]]:
    """Yield the objects that the release's network needs, each with the option it comes from."""
    for item in mode_of(plan.options).objects(plan, plan.options or NO_NETWORK):
        yield ("network",), item


def join(plan: NetworkPlan) -> Object:
    """Return how a DDS participant that is not a ROS node finds those of the release."""
    return dict(mode_of(plan.options).join(plan, plan.options)) if plan.options else {}


def ready_words(plan: NetworkPlan) -> tuple[str, ...]:
    """Return what the readiness probe checks (rigel_inpod/README.md): a node, a router, or DDS."""
    if not plan.ros.dds:
        return ("node",)
    if plan.middleware == "zenoh":
        return ("zenoh", "--port", str(ZENOH_PORT))
    interface = ("--interface", INTERFACE) if mode_of(plan.options).attached else ()
    domain = () if plan.domain_id is None else ("--domain", str(plan.domain_id))
    return ("dds", *domain, *interface)


def ros_variables(plan: NetworkPlan) -> dict[str, Object]:
    """Return ROS 2's own variables; a plain DDS application has none."""
    if not plan.ros.rmw:
        return {}
    found: dict[str, Object] = {}
    if plan.domain_id is not None:
        found["ROS_DOMAIN_ID"] = {"value": str(plan.domain_id)}
    if mode_of(plan.options).looks_beyond:
        found |= OLD_RANGE if plan.distro.lower() in BEFORE_IRON else RANGE
    if plan.middleware:
        found["RMW_IMPLEMENTATION"] = {"value": MIDDLEWARE[plan.middleware]}
    return found

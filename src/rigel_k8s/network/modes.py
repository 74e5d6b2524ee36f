"""The network of a release: which mode makes its objects and wires its pods."""

from __future__ import annotations

from collections.abc import Iterator

import attrs

from rigel_k8s.network.attachments import attached_objects, attached_wiring
from rigel_k8s.network.dds import EARLY
from rigel_k8s.network.host import host_objects, host_wiring
from rigel_k8s.network.options import MIDDLEWARE
from rigel_k8s.network.peers import peer_objects, peer_wiring
from rigel_k8s.network.servers import (
    discovery_objects,
    discovery_wiring,
    zenoh_objects,
    zenoh_wiring,
)
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring, network_note
from rigel_k8s.objects.pods import Object
from rigel_k8s.problems import Path

__all__ = ["network_objects", "wiring"]

BEFORE_IRON = EARLY - {"iron"}

WIRINGS = {
    "macvlan": attached_wiring,
    "ipvlan": attached_wiring,
    "attachment": attached_wiring,
    "peers": peer_wiring,
    "discovery-server": discovery_wiring,
    "zenoh": zenoh_wiring,
    "host": host_wiring,
}
OBJECTS = {
    "macvlan": attached_objects,
    "ipvlan": attached_objects,
    "attachment": attached_objects,
    "peers": peer_objects,
    "discovery-server": discovery_objects,
    "zenoh": zenoh_objects,
    "host": host_objects,
}


def wiring(plan: NetworkPlan, pod: PodIdentity) -> Wiring:
    """Return what the release's network adds to one pod."""
    made = WIRINGS.get(plan.mode)
    if plan.options is None or made is None:
        return unwired(plan)
    found = made(plan, pod, plan.options)
    return attrs.evolve(found, env=ros_variables(plan) | dict(found.env))


def network_objects(plan: NetworkPlan) -> Iterator[tuple[Path, Object]]:
    """Yield the objects that the release's network needs, each with the option it comes from."""
    made = OBJECTS.get(plan.mode)
    if plan.options is not None and made is not None:
        for item in made(plan, plan.options):
            yield ("network",), item


def unwired(plan: NetworkPlan) -> Wiring:
    """Return what a pod gets that nobody wires: a ROS 1 pod nothing at all."""
    if plan.ros == "1":
        return Wiring()
    return Wiring(env=ros_variables(plan), annotations=network_note(plan))


#: Nodes look for others beyond their own machine, whatever an image says; not LOCALHOST with peers,
#: which would try more ports of each and bring shared memory back.
RANGE = {"ROS_AUTOMATIC_DISCOVERY_RANGE": {"value": "SUBNET"}}
#: The same before iron.
OLD_RANGE = {"ROS_LOCALHOST_ONLY": {"value": "0"}}


def ros_variables(plan: NetworkPlan) -> dict[str, Object]:
    """Return ROS 2's own variables; a plain DDS application has none."""
    if plan.ros != "2":
        return {}
    found: dict[str, Object] = {}
    if plan.domain_id is not None:
        found["ROS_DOMAIN_ID"] = {"value": str(plan.domain_id)}
    if plan.mode not in ("none", "zenoh"):
        found |= OLD_RANGE if plan.distro.lower() in BEFORE_IRON else RANGE
    if plan.middleware:
        found["RMW_IMPLEMENTATION"] = {"value": MIDDLEWARE[plan.middleware]}
    return found

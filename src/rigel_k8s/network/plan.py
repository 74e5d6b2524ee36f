"""A release's network, everything resolved: who takes part, the domain, the addresses."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from rigel_k8s.network.addresses import assigned, given
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity
from rigel_k8s.objects.naming import Ros

__all__ = ["ATTACHED", "OVER_PODS", "middleware_word", "network_of", "network_plan"]

#: Modes with a second interface by Multus.
ATTACHED = frozenset({"macvlan", "ipvlan", "attachment"})
#: Modes over the pod network, where all applications of a cluster could hear each other.
OVER_PODS = frozenset({"peers", "discovery-server", "zenoh"})

#: What a mode runs on, where there is no choice.
BOUND = {"discovery-server": "fastdds", "zenoh": "zenoh"}

#: Domains whose ports no Linux gives to anybody else.
SAFE_DOMAINS = 101


def network_of(told: Network | str | None) -> Network | None:
    """Return the options of a network that may be written as a word."""
    if told is None or isinstance(told, Network):
        return told
    return Network(mode=told)  # type: ignore[arg-type] # structuring lets no other words pass


def middleware_word(told: str | None) -> str | None:
    """Return fastdds, cyclonedds or zenoh for any of a middleware's names."""
    return (
        told.removeprefix("rmw_").removesuffix("_cpp").replace("fastrtps", "fastdds")
        if told
        else None
    )


def network_plan(
    told: Network | str | None,
    *,
    namespace: str,
    release: str,
    ros: Ros,
    distro: str,
    middleware: str | None = None,
    pods: Sequence[PodIdentity] = (),
    previous: Sequence[Mapping[str, Any]] = (),
    pull_secrets: Sequence[str] = (),
) -> NetworkPlan:
    """Return the plan.

    Args:
        told: the option `network`.
        middleware: the option `middleware`.
        pods: all workloads of the release, roscore among them.
        previous: the objects of the last revision, which tell who has which address.

    Raises:
        ValueError: there are not enough static addresses; check_network tells it before.
    """
    network = network_of(told)
    names = [pod.name for pod in pods]
    static = network is not None and network.ipam == "static"
    salt = f"{namespace}/{release}"
    return NetworkPlan(
        namespace=namespace,
        release=release,
        options=network,
        ros=ros,
        distro=distro,
        middleware=middleware_word(middleware) or (BOUND.get(network.mode) if network else None),
        domain_id=domain(network, ros, salt),
        pods=tuple(pods),
        addresses=assigned(network, names, given(previous), salt) if network and static else {},
        pull_secrets=tuple(pull_secrets),
    )


def domain(network: Network | None, ros: Ros, salt: str) -> int | None:
    """Return the DDS domain: as told, else 0 where laptops are, and one of its own elsewhere.

    None where nobody says it: an image of ROS 2 may, and a plain DDS application does by itself.
    """
    if network is None or network.domain_id is not None:
        return network.domain_id if network else None
    if network.mode == "none" or ros == "none":
        return None
    if network.mode not in OVER_PODS:
        return 0
    digest = hashlib.sha256(salt.encode()).digest()
    return 1 + int.from_bytes(digest[:8], "big") % SAFE_DOMAINS

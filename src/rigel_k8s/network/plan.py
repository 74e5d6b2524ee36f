"""A release's network with everything resolved: its pods, the domain, the addresses."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from rigel_k8s.network.addresses import assign, read_addresses
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity
from rigel_k8s.ros import Ros

#: Domains whose ports Linux does not give to other programs.
SAFE_DOMAINS = 101


def network_plan(
    network: Network | None,
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
        pods: all workloads of the release, roscore among them.
        previous: the objects of the last revision, which contain the addresses.

    Raises:
        ValueError: there are not enough static addresses; check_network reports it before.
    """
    names = [pod.name for pod in pods]
    static = network is not None and network.ipam == "static"
    salt = f"{namespace}/{release}"
    return NetworkPlan(
        namespace=namespace,
        release=release,
        options=network,
        on_machine=mode_of(network).in_machine_network,
        ros=ros,
        distro=distro,
        middleware=middleware or mode_of(network).middleware,
        domain_id=domain(network, ros, salt),
        pods=tuple(pods),
        addresses=assign(network, names, read_addresses(previous), salt)
        if network and static
        else {},
        pull_secrets=tuple(pull_secrets),
    )


def domain(network: Network | None, ros: Ros, salt: str) -> int | None:
    """Return the DDS domain: the option's, or 0 on the machines' network, or one per release.

    None if neither decides: an image of ROS 2 may set it, and a plain DDS application sets its own.
    """
    if network is None or network.domain_id is not None:
        return network.domain_id if network else None
    if not mode_of(network).connects or not ros.nodes:
        return None
    if not mode_of(network).own_domain:
        return 0
    digest = hashlib.sha256(salt.encode()).digest()
    return 1 + int.from_bytes(digest[:8], "big") % SAFE_DOMAINS

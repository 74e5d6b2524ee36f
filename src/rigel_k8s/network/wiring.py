"""What a network mode adds to one pod, as parts that any workload adds to its pod template."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.network.options import Network
from rigel_k8s.objects.overlay import list_mappings, parse_json
from rigel_k8s.ros import Ros

Object = dict[str, Any]

#: On pods: how they are networked, as JSON, so a pod can be examined without its Rigelfile.
NETWORK_ANNOTATION = "rigel-k8s/network"
#: On pods: the networks that they request from Multus, and what Multus has attached.
NETWORKS_ANNOTATION = "k8s.v1.cni.cncf.io/networks"
NETWORK_STATUS_ANNOTATION = "k8s.v1.cni.cncf.io/network-status"


@attrs.frozen
class PodIdentity:
    """One workload of the release whose pods are wired.

    Attributes:
        name: the workload's Kubernetes name, also that of its Service in mode `peers`.
        image: its container's image, from which init containers are made.
        replicas: how many pods, None for one.
        on_machine: its own options put it on its machine's network, whatever the release's mode.
        shares_memory: several programs run in it, with one /dev/shm of a size for all.
        like: fields of its container that init containers share: imagePullPolicy, resources, and
            the user in securityContext.
    """

    name: str
    image: str
    replicas: int | None = None
    on_machine: bool = False
    shares_memory: bool = False
    like: Mapping[str, Any] = attrs.field(factory=dict)


@attrs.frozen
class NetworkPlan:
    """A release's network with everything resolved; the same for all its pods.

    Attributes:
        options: as written; None where the Rigelfile has no `network`.
        distro: application.distro.
        middleware: fastdds, cyclonedds or zenoh; None if the options name none.
        domain_id: the DDS domain; None if only the images set it.
        pods: all workloads of the release that take part.
        addresses: workload name -> its address with prefix length, for `ipam: static`.
        pull_secrets: Secrets with registry credentials, for pods that a mode adds.
        on_machine: its pods have their machine's own network.
    """

    namespace: str
    release: str
    options: Network | None
    ros: Ros
    distro: str
    middleware: str | None = None
    domain_id: int | None = None
    pods: Sequence[PodIdentity] = ()
    addresses: Mapping[str, str] = attrs.field(factory=dict)
    pull_secrets: Sequence[str] = ()
    on_machine: bool = False

    @property
    def mode(self) -> str:
        """The mode, "none" where nothing is wired."""
        return self.options.mode if self.options else "none"


@attrs.frozen
class Wiring:
    """What is added to a pod template.

    Attributes:
        env: variable -> its source, {"value": ...} or {"valueFrom": ...}; a user's own value wins.
        annotations: of the pod.
        volumes: of the pod; mounts: of the ROS container.
        pod: further fields of the pod's spec (hostNetwork, dnsPolicy ...).
    """

    env: Mapping[str, Object] = attrs.field(factory=dict)
    annotations: Mapping[str, str] = attrs.field(factory=dict)
    init_containers: Sequence[Object] = ()
    volumes: Sequence[Object] = ()
    mounts: Sequence[Object] = ()
    pod: Mapping[str, Any] = attrs.field(factory=dict)


def network_note(plan: NetworkPlan, *, shared_memory: bool = False, **more: Any) -> dict[str, str]:
    """Return the annotation that describes how a pod is networked.

    Args:
        shared_memory: its Fast DDS shares memory with others of its address.
    """
    given = {
        "mode": plan.mode,
        "ros": plan.ros.name,
        "middleware": plan.middleware,
        "domain": plan.domain_id,
        "shared_memory": shared_memory or None,
        **more,
    }
    known = {key: value for key, value in given.items() if value is not None}
    return {NETWORK_ANNOTATION: json.dumps(known, sort_keys=True)}


def read_status(annotations: Mapping[str, str]) -> Iterator[tuple[str, list[str]]]:
    """Yield each interface that Multus has noted on a pod, with its addresses."""
    noted: list[Any] = parse_json(annotations.get(NETWORK_STATUS_ANNOTATION), [])
    for network in list_mappings(noted):
        ips = network.get("ips")
        yield str(network.get("interface")), list(map(str, ips if isinstance(ips, list) else ()))

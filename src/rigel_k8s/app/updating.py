"""How pods are replaced: by hand-over if the gate or the layer allows it, else one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import attrs

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.volumes import device_of, mount_of
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.objects.overlay import containers_of, list_mappings, mapping, pod_of
from rigel_k8s.objects.podoptions import Readiness, RollingUpdate, Volume
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.scalars import Share
from rigel_k8s.objects.workloads import ReleaseContext

#: On a Deployment whose updates may hand over: how it is updated, and why.
UPDATE_ANNOTATION = "rigel-k8s/update"
#: Access modes of volumes that only one machine, or only one pod, may mount.
EXCLUSIVE = ("ReadWriteOnce", "ReadWriteOncePod")


@attrs.frozen(kw_only=True)
class Candidate:
    """A workload of which an update may hand over.

    Attributes:
        ros_name: the full name of the node, if it is known.
        update: the user's options for it.
        obstacle: why it cannot be handed over; see find_obstacle.
    """

    release: ReleaseContext
    workload: str
    ros_name: str | None
    update: RollingUpdate
    obstacle: str | None


@attrs.frozen
class Way:
    """How a workload's pods are replaced.

    Attributes:
        reason: why it is not handed over, for users; "" for HandOver.
        update: the user's options for it.
        env: the variables that a pod needs for being handed over.
        drain: seconds that the old pod may take longer to stop.
    """

    name: Literal["HandOver", "Recreate", "Rolling"]
    reason: str = ""
    update: RollingUpdate = attrs.field(factory=RollingUpdate)
    env: Mapping[str, Object] = attrs.field(factory=dict)
    drain: int = 0

    @property
    def strategy(self) -> Object:
        """The Deployment's strategy."""
        if self.name == "Recreate":
            return {"type": "Recreate"}
        numbers = {
            "maxSurge": share(self.update.max_surge, 1),
            "maxUnavailable": share(self.update.max_unavailable, 0),
        }
        return {"type": "RollingUpdate", "rollingUpdate": numbers}

    def annotations(self, release: ReleaseContext) -> dict[str, str]:
        """Return the annotations about a Deployment's updates."""
        ros = release.ros
        if self.name != "HandOver" and not (ros.hands_over and (release.gate or ros.rmw)):
            return {}
        return {UPDATE_ANNOTATION: f"{self.name}: {self.reason}" if self.reason else self.name}


def is_rolling(update: RollingUpdate | None) -> bool:
    """Return whether an update by surge is requested, src.plugin's default."""
    if update is None:
        return False
    if update.strategy is None:
        return update.max_surge is not None or update.max_unavailable is not None
    return update.strategy.lower() in ("rolling", "rollingupdate")


class OnRequest(str):
    """Why a node is not handed over by default; a user who requests it gets it."""

    __slots__ = ()


def requests_hand_over(update: RollingUpdate | None) -> bool:
    """Return whether the user requests a hand-over."""
    return update is not None and (update.strategy or "").lower() == "handover"


def find_exclusive(
    node: NodeOptions, volumes: Mapping[str, Volume], network: Network | None
) -> str | None:
    """Return why Kubernetes cannot run two pods of a node on one machine, None if it can.

    A machine may have one GPU only, and has each port once. An update with both pods never ends.

    Args:
        volumes: the release's persistent volumes, by name.
    """
    own = (*node.resources.limits.items(), *node.resources.requests.items())
    asked = [(str(name), str(count)) for name, count in own]
    for container in containers_of(node.patch):
        limits = mapping(mapping(container.get("resources")).get("limits"))
        asked += [(str(name), str(count)) for name, count in limits.items()]
    devices = [str(one.resource) for one in map(device_of, node.devices) if one.resource]
    devices += [str(name) for name, count in asked if "/" in name and count.strip("0.")]
    if devices:
        return f"it has the device {devices[0]}"
    spec = pod_of(node.patch)
    on_machine = node.host_network or bool(spec.get("hostNetwork"))
    on_machine = on_machine or mode_of(network).in_machine_network
    for container in containers_of(node.patch):
        ports = list(list_mappings(container.get("ports")))
        if any("hostPort" in port for port in ports) or (on_machine and ports):
            return "it has a port of its machine"
    if on_machine and node.ports:
        return "it has a port of its machine"
    for volume in list_claims(node, volumes):
        if volume.access_mode == "ReadWriteOncePod":
            return f"its volume {volume.name} is {volume.access_mode}"
    return None


def find_obstacle(
    node: NodeOptions,
    volumes: Mapping[str, Volume],
    network: Network | None,
    ready_by: Sequence[str | None],
    *,
    shares_network: bool = False,
) -> str | None:
    """Return why two pods of a node cannot run side by side, whatever arbitrates between them.

    Args:
        volumes: the release's persistent volumes, by name.
        ready_by: the readiness checks that support hand-overs.
        shares_network: two of them can run on one machine's own network.
    """
    if exclusive := find_exclusive(node, volumes, network):
        return exclusive
    if own := find_own_machine(node, shares_network=shares_network):
        return own
    ready = node.readiness
    if ready.own_checks if isinstance(ready, Readiness) else ready not in ready_by:
        return "it has a readiness check of its own"
    return find_shared(node, volumes)


def find_clash(node: NodeOptions, volumes: Mapping[str, Volume]) -> str | None:
    """Return why two pods of a node that can run at once disturb each other."""
    return find_own_machine(node) or find_shared(node, volumes)


def find_own_machine(node: NodeOptions, *, shares_network: bool = False) -> str | None:
    """Return what a node has of its machine that two pods cannot use side by side."""
    device = next((d.path or d.resource for d in map(device_of, node.devices)), None)
    found = {
        f"it has the device {device}": bool(node.devices),
        "it uses the machine's own network": node.host_network and not shares_network,
        "it is privileged": bool(node.security_context.get("privileged")),
    }
    return next((reason for reason, holds in found.items() if holds), None)


def find_shared(node: NodeOptions, volumes: Mapping[str, Volume]) -> str | None:
    """Return why a node's volumes, or its patch, prevent two pods from running side by side."""
    for volume in list_claims(node, volumes):
        if volume.access_mode in EXCLUSIVE:
            return f"its volume {volume.name} is {volume.access_mode}"
    return find_patched(node.patch)


def list_claims(node: NodeOptions, volumes: Mapping[str, Volume]) -> Iterator[Volume]:
    """Yield the persistent volumes that a node mounts."""
    names = (str(mount_of(item).name) for item in node.volumes)
    yield from (volumes[name] for name in names if name in volumes)


def has_variable(node: NodeOptions, name: str) -> bool:
    """Return whether the user sets an environment variable."""
    if isinstance(node.env, Mapping):
        return name in {str(key) for key in node.env}
    return name in {str(one.name) for one in node.env}


def patches_privileged(patch: Mapping[str, Any]) -> bool:
    """Return whether a user's own part of a Deployment makes a container privileged."""
    contexts = (mapping(one.get("securityContext")) for one in containers_of(patch))
    return any(context.get("privileged") for context in contexts)


def find_patched(patch: Mapping[str, Any]) -> str | None:
    """Return why a user's own part of a Deployment prevents two pods from running side by side."""
    spec = pod_of(patch)
    if spec.get("hostNetwork"):
        return "it uses the machine's own network"
    if patches_privileged(patch):
        return "it is privileged"
    if any("persistentVolumeClaim" in one for one in list_mappings(spec.get("volumes"))):
        return "it mounts a claim that may be exclusive"
    return None


def share(value: Share | None, default: int) -> int | str:
    """Return a number of pods, or a percentage, for the Kubernetes field."""
    return default if value is None else value.value

"""The state of Multus and whereabouts on each machine, and which pods miss their network."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.multus.install import marks_of
from rigel_k8s.network.multus.installation import Found, MultusPresence, complete_options, find
from rigel_k8s.network.multus.interfaces import Missing, find_without_interface
from rigel_k8s.network.multus.proving import find_proven
from rigel_k8s.network.options import Install
from rigel_k8s.objects.facts import is_ready, stays_ready


@attrs.frozen
class PartStatus:
    """Multus or whereabouts: where it is, its image, and whether this program installed it."""

    where: str
    image: str
    ours: bool


@attrs.frozen
class NodeStatus:
    """One machine.

    Attributes:
        up: whether its kubelet answers.
        multus: whether the daemon is ready there.
        whereabouts: whether its part is ready there.
        proven: whether a pod was attached there since the machine started.
        conf_dir: where it keeps CNI configuration, as far as that is known.
        bin_dir: where it keeps CNI programs.
    """

    name: str
    platform: str
    conf_dir: str
    bin_dir: str
    up: bool
    multus: bool
    whereabouts: bool
    proven: bool


@attrs.frozen
class NetworkStatus:
    """The cluster's second networks.

    Attributes:
        multus: None if it is not installed.
        whereabouts: None if it is not installed.
        missing: running pods without a network that they request.
    """

    multus: PartStatus | None
    whereabouts: PartStatus | None
    nodes: tuple[NodeStatus, ...]
    missing: tuple[Missing, ...]

    @property
    def ok(self) -> bool:
        """Whether every machine that is up attaches pods, and no pod misses a network."""
        if self.multus is None or self.whereabouts is None or self.missing:
            return False
        return all(n.multus and n.whereabouts for n in self.nodes if n.up)


def network_status(cluster: Cluster, options: Install) -> NetworkStatus:
    """Look at all machines and pods of a cluster."""
    found = find(cluster, complete_options(cluster, options))
    pods = cluster.list("v1", "Pod")
    marks = marks_of(found)
    good = find_proven(cluster, marks)
    ready = {
        name: _nodes_of(part, pods)
        for name, part in (("multus", found.multus), ("whereabouts", found.whereabouts))
    }
    return NetworkStatus(
        _describe_part(found.multus),
        _describe_part(found.whereabouts),
        tuple(_nodes(found, ready, good)),
        tuple(find_without_interface(pods)),
    )


def _describe_part(part: MultusPresence | None) -> PartStatus | None:
    return PartStatus(part.where, part.image, part.ours) if part else None


def _nodes_of(part: MultusPresence | None, pods: list[dict[str, Any]]) -> set[str]:
    """Return the machines on which a part's pod is ready."""
    return {pod["spec"].get("nodeName", "") for pod in _pods_of(part, pods) if stays_ready(pod)}


def _pods_of(part: MultusPresence | None, pods: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a part's pods."""
    owners = {one["metadata"]["uid"] for one in part.sets} if part else set()
    return [
        pod
        for pod in pods
        if any(o["uid"] in owners for o in pod["metadata"].get("ownerReferences") or [])
    ]


def _nodes(found: Found, ready: Mapping[str, set[str]], good: set[str]) -> list[NodeStatus]:
    platforms = {name: group.platform for group in found.groups for name in group.nodes}
    return [
        NodeStatus(
            name,
            platforms[name].kind,
            platforms[name].conf_dir,
            platforms[name].bin_dir,
            is_ready(node),
            name in ready["multus"],
            name in ready["whereabouts"],
            name in good,
        )
        for node in found.nodes
        if (name := node["metadata"]["name"]) in platforms
    ]

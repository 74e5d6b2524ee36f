"""The state of Multus and whereabouts on each machine, and which pods miss their network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.network.options import Install
from rigel_k8s.objects.facts import is_ready, stays_ready
from rigel_multus.install import find
from rigel_multus.installation import PARTS, Presence
from rigel_multus.interfaces import UnattachedPod, find_without_interface
from rigel_multus.proving import find_proven


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
    missing: tuple[UnattachedPod, ...]

    @property
    def ok(self) -> bool:
        """Whether every machine that is up attaches pods, and no pod misses a network."""
        if self.multus is None or self.whereabouts is None or self.missing:
            return False
        return all(n.multus and n.whereabouts for n in self.nodes if n.up)


def network_status(cluster: Cluster, options: Install) -> NetworkStatus:
    """Look at all machines and pods of a cluster."""
    installation = find(cluster, options)
    pods = cluster.list("v1", "Pod")
    proven = find_proven(cluster, installation)
    multus, whereabouts = (installation.parts.get(part) for part in PARTS)
    with_multus, with_whereabouts = find_ready(multus, pods), find_ready(whereabouts, pods)
    platforms = {name: group.platform for group in installation.groups for name in group.nodes}
    nodes = []
    for node in installation.linux:
        name = node["metadata"]["name"]
        nodes.append(
            NodeStatus(
                name,
                platforms[name].kind,
                platforms[name].conf_dir,
                platforms[name].bin_dir,
                up=is_ready(node),
                multus=name in with_multus,
                whereabouts=name in with_whereabouts,
                proven=name in proven,
            )
        )
    return NetworkStatus(
        describe_part(multus),
        describe_part(whereabouts),
        tuple(nodes),
        tuple(find_without_interface(pods)),
    )


def describe_part(part: Presence | None) -> PartStatus | None:
    """Return the state of a part as the command prints it."""
    return PartStatus(part.where, part.image, part.ours) if part else None


def find_ready(part: Presence | None, pods: Sequence[Mapping[str, Any]]) -> set[str]:
    """Return the machines on which a part's pod is ready."""
    sets = {one["metadata"]["uid"] for one in part.sets} if part else set()
    return {
        pod["spec"].get("nodeName", "")
        for pod in pods
        if stays_ready(pod)
        and any(owner["uid"] in sets for owner in pod["metadata"].get("ownerReferences") or [])
    }

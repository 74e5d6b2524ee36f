"""Whether the cluster has a machine for each workload; checked before anything is applied."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.naming import HOSTNAME

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

Manifests = Iterable[Mapping[str, Any]]


def check_places(objects: Manifests, cluster: Cluster) -> None:
    """Raise UserError if a workload needs labels that no machine of the cluster has.

    A user who may not list machines can still deploy: the scheduler reports it later.
    """
    wanted = dict(selectors(objects))
    if not wanted:
        return
    try:
        nodes = cluster.nodes()
    except ClusterError:
        return
    missing = list(find_unplaced(wanted, nodes))
    if missing:
        count = len(missing)
        raise UserError(
            missing[0] if count == 1 else f"{count} workloads need machines that do not exist",
            details=[] if count == 1 else missing,
            hint=remedy(wanted, nodes),
        )


def selectors(objects: Manifests) -> Iterator[tuple[str, Mapping[str, str]]]:
    """Yield (workload, the labels its machine must have)."""
    for item in objects:
        spec = item.get("spec", {}).get("template", {}).get("spec", {})
        if spec.get("nodeSelector"):
            yield f"{item['kind']} {item['metadata']['name']}", spec["nodeSelector"]


def find_unplaced(
    wanted: Mapping[str, Mapping[str, str]], nodes: Sequence[Mapping[str, Any]]
) -> Iterator[str]:
    """Yield a line for each workload without a machine."""
    for workload, labels in wanted.items():
        if not any(fits(labels, node) for node in nodes):
            listed = ", ".join(f"{key}={value}" for key, value in labels.items())
            yield f"no machine of the cluster has the labels that {workload} needs: {listed}"


def fits(labels: Mapping[str, str], node: Mapping[str, Any]) -> bool:
    """Return whether a machine has all labels."""
    return bool(labels.items() <= node["metadata"].get("labels", {}).items())


def remedy(wanted: Mapping[str, Mapping[str, str]], nodes: Sequence[Mapping[str, Any]]) -> str:
    """Return the commands that add what is missing."""
    remedies: dict[str, None] = defaultdict()
    for labels in wanted.values():
        if any(fits(labels, node) for node in nodes):
            continue
        host = labels.get(HOSTNAME, "NODE")
        names = {node["metadata"].get("labels", {}).get(HOSTNAME) for node in nodes}
        if host != "NODE" and host not in names:
            remedies[f"placement.node must be one of {', '.join(sorted(filter(None, names)))}"] = (
                None
            )
            continue
        own = [f"{key}={value}" for key, value in labels.items() if key != HOSTNAME]
        remedies[f"kubectl label node {host} {' '.join(own)}"] = None
    return "; ".join(remedies)

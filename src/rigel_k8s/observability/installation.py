"""Facts about a cluster that the stack needs, and where the stack is; only reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.facts import is_default_class
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.release.labelling import NAMESPACE_ANNOTATION


def find_namespace(cluster: Cluster) -> str | None:
    """Return the namespace of the cluster's stack, None if it has no stack."""
    roles = cluster.list(
        "rbac.authorization.k8s.io/v1", "ClusterRole", labels={RELEASE_LABEL: RELEASE}
    )
    found = {_annotations(role).get(NAMESPACE_ANNOTATION, "") for role in roles} - {""}
    return min(found, default=None)


def gives_storage(cluster: Cluster) -> bool:
    """Return whether a claim that names no StorageClass gets a volume."""
    classes = cluster.list("storage.k8s.io/v1", "StorageClass")
    return any(is_default_class(one) for one in classes)


def api_servers(cluster: Cluster) -> tuple[str, ...]:
    """Return the addresses that the API servers' connections to pods come from.

    On the way to another machine, a tunnel may replace the address by its own: flannel uses the
    first one of the machine's pods.
    """
    slices = cluster.list(
        "discovery.k8s.io/v1",
        "EndpointSlice",
        "default",
        labels={"kubernetes.io/service-name": "kubernetes"},
    )
    found = {address for one in slices for end in one["endpoints"] for address in end["addresses"]}
    for node in cluster.nodes():
        own = {entry["address"] for entry in node.get("status", {}).get("addresses", [])}
        if found & own and (range_ := node["spec"].get("podCIDR")):
            found = found | {str(range_).partition("/")[0]}
    return tuple(sorted(found))


def _annotations(item: Mapping[str, Any]) -> Mapping[str, Any]:
    return item["metadata"].get("annotations") or {}

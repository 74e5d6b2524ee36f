"""Which addresses Services have, as far as the cluster shows it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from rigel_k8s.errors import ClusterError
from rigel_k8s.network.preflight.attachments import subnet
from rigel_k8s.network.preflight.machine import Subnet
from rigel_k8s.objects.refs import ObjectRef

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

#: An address for documentation (RFC 5737): no cluster gives its Services any of these.
NOBODYS = "192.0.2.1"
VALID = re.compile(r"range of valid IPs is ([0-9a-fA-F.:/]+)")


def service_ranges(cluster: Cluster) -> list[Subnet]:
    """Return the ranges of Services; at worst only the address of the Service `kubernetes`.

    Clusters from 1.33 on list them. Others name theirs in the error when a Service requests an
    address outside of it, which is tried as a dry run.
    """
    for texts in (_list_ranges, _provoke_refusal, _read_default):
        found = [one for one in map(subnet, texts(cluster)) if one is not None]
        if found:
            return found
    return []


def _list_ranges(cluster: Cluster) -> Iterator[str]:
    try:
        objects = cluster.list("networking.k8s.io/v1", "ServiceCIDR")
    except ClusterError:
        return
    for item in objects:
        yield from (item.get("spec") or {}).get("cidrs") or []


def _provoke_refusal(cluster: Cluster) -> Iterator[str]:
    try:
        cluster.create(_service(), dry_run=True)
    except ClusterError as error:
        yield from VALID.findall(error.message)


def _service() -> dict[str, Any]:
    return {
        "apiVersion": "v1",
        "kind": "Service",
        "metadata": {"name": "rigel-preflight", "namespace": "default"},
        "spec": {"clusterIP": NOBODYS, "ports": [{"port": 1}]},
    }


def _read_default(cluster: Cluster) -> Iterator[str]:
    try:
        found = cluster.get(ObjectRef("v1", "Service", "default", "kubernetes"))
    except ClusterError:
        return
    yield from ((found or {}).get("spec") or {}).get("clusterIPs") or []

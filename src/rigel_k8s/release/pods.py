"""The pods of a release."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rigel_k8s.objects.marks import JOINED_ANNOTATION, RELEASE_LABEL
from rigel_k8s.release.types import ReleaseId

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster


def list_pods(
    cluster: Cluster, release: ReleaseId, labels: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Return a release's pods as the API server has them; with labels, only those that have them.

    Pods of `rigel join` are left out: no node of the release is in them.

    Raises:
        ClusterError: they cannot be listed.
    """
    own = {**(labels or {}), RELEASE_LABEL: release.name}
    found = cluster.list("v1", "Pod", release.namespace, labels=own)
    return [
        pod for pod in found if JOINED_ANNOTATION not in (pod["metadata"].get("annotations") or {})
    ]

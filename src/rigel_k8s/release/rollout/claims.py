"""Why a claim is not bound: some wait for their first pod, as they should."""

from __future__ import annotations

from collections.abc import Sequence

from rigel_k8s.errors import ClusterError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.release.rollout.causes import Cause

WAITS_FOR_POD = "WaitForFirstConsumer"


def explain_claim(cluster: Cluster, claim: Manifest) -> Cause | None:
    """Return why a claim is not bound, None if it only waits for a pod.

    Raises:
        ClusterError: its events cannot be read.
    """
    events = cluster.events(claim)
    if waits_for_pod(cluster, claim, events):
        return None
    messages = [event.get("message", "") for event in events]
    message = f": {messages[-1]}" if messages else ""
    return Cause("claim", f"claim {claim['metadata']['name']} has no volume{message}")


def waits_for_pod(cluster: Cluster, claim: Manifest, events: Sequence[Manifest]) -> bool:
    """Whether a claim gets its volume only when a pod uses it.

    Its storage class decides that. If we may not see classes, the claim's events show it.
    """
    name = (claim.get("spec") or {}).get("storageClassName")
    try:
        classes = cluster.list("storage.k8s.io/v1", "StorageClass")
    except ClusterError:
        return any(event.get("reason") == WAITS_FOR_POD for event in events)
    modes = {known["metadata"]["name"]: known.get("volumeBindingMode") for known in classes}
    return modes.get(name) == WAITS_FOR_POD

"""Where a part of the stack keeps what it writes."""

from __future__ import annotations

from rigel_k8s.observability.manifests.frame import Object


def data_volume(part: str, *, kept: bool) -> Object:
    """Return a pod's volume `data`: the part's claim, or one that is deleted with the pod."""
    if kept:
        return {"name": "data", "persistentVolumeClaim": {"claimName": f"{part}-data"}}
    return {"name": "data", "emptyDir": {}}

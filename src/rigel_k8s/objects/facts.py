"""What the status of live objects contains: conditions, readiness, defaults; pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rigel_k8s.objects.refs import Manifest

#: The annotation of the StorageClass that claims without one get.
DEFAULT_CLASS = "storageclass.kubernetes.io/is-default-class"


def find_condition(status: Mapping[str, Any], kind: str) -> Mapping[str, Any]:
    """Return one of a status' conditions, empty where it has none of that kind."""
    for entry in status.get("conditions") or []:
        if entry.get("type") == kind:
            found: Mapping[str, Any] = entry
            return found
    return {}


def is_met(status: Mapping[str, Any], kind: str) -> bool:
    """Whether one of a status' conditions is true; an unknown one is not."""
    return find_condition(status, kind).get("status") == "True"


def is_ready(live: Manifest) -> bool:
    """Whether a Pod is ready, or the kubelet of a Node answers."""
    return is_met(live.get("status") or {}, "Ready")


def is_ending(live: Manifest) -> bool:
    """Whether an object is being deleted; a pod may keep running for its grace period."""
    return bool(live["metadata"].get("deletionTimestamp"))


def stays_ready(pod: Manifest) -> bool:
    """Whether a pod is ready and is not being deleted."""
    return is_ready(pod) and not is_ending(pod)


def has_ended(pod: Manifest) -> bool:
    """Whether the programs of a pod have ended, and are not started again."""
    return (pod.get("status") or {}).get("phase") in ("Succeeded", "Failed")


def runs(status: Mapping[str, Any], container: str) -> bool:
    """Whether a container of a pod with this status runs."""
    states = status.get("containerStatuses") or []
    return any(s["name"] == container and "running" in (s.get("state") or {}) for s in states)


def is_out_of_reach(pod: Manifest) -> bool:
    """Whether Kubernetes has lost the machine that a pod was ready on; the pod may still run there.

    Kubernetes' node controller then takes the condition Ready from the pod and changes no other.
    A kubelet takes ContainersReady too, and a readiness gate gives a reason.
    """
    status = pod.get("status") or {}
    ready = find_condition(status, "Ready")
    lost = ready.get("status") == "False" and not ready.get("reason")
    return lost and is_met(status, "ContainersReady")


def is_default_class(storage_class: Manifest) -> bool:
    """Whether claims that name no StorageClass get this one."""
    annotations = storage_class["metadata"].get("annotations") or {}
    return bool(annotations.get(DEFAULT_CLASS) == "true")


def is_empty_claim(claim: Manifest) -> bool:
    """Whether an object is a claim that has no volume yet, and so no data."""
    if claim["kind"] != "PersistentVolumeClaim":
        return False
    pending = (claim.get("status") or {}).get("phase") == "Pending"
    return pending and not (claim.get("spec") or {}).get("volumeName")

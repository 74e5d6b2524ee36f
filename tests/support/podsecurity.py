"""What the Pod Security level "restricted" requires of a pod, beside what it refuses."""

from __future__ import annotations

from typing import Any


def list_missing(spec: dict[str, Any]) -> list[str]:
    """Return what the level requires of a pod's spec and is not there."""
    shared = spec.get("securityContext", {})
    missing = []
    for container in [*spec.get("initContainers", ()), *spec["containers"]]:
        own = container.get("securityContext", {})
        merged = {**shared, **own}
        wanted = {
            "runAsNonRoot": merged.get("runAsNonRoot") is True,
            "runAsUser": merged.get("runAsUser", 0) > 0,
            "seccompProfile": merged.get("seccompProfile", {}).get("type") == "RuntimeDefault",
            "allowPrivilegeEscalation": own.get("allowPrivilegeEscalation") is False,
            "drop": own.get("capabilities", {}).get("drop") == ["ALL"],
        }
        missing += [f"{container['name']}: {name}" for name, there in wanted.items() if not there]
    return missing

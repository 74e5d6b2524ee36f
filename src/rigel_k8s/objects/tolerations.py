"""Whether a pod may run on a tainted machine, and whether it stays on one that is unreachable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rigel_k8s.objects.podoptions import Toleration
from rigel_k8s.objects.pods import Object, drop_empty

#: A robot that loses its network keeps its pods: without these they are evicted after 300 s.
STAY = ("node.kubernetes.io/not-ready", "node.kubernetes.io/unreachable")


def tolerations(asked: Sequence[Toleration], *, pinned: bool) -> list[Object]:
    """Return the pod's tolerations; a pod pinned to a machine stays when its network fails."""
    result = [toleration(item) for item in asked]
    if pinned:
        result += [{"key": key, "operator": "Exists", "effect": "NoExecute"} for key in STAY]
    return result


def stays(pod: Mapping[str, Any]) -> bool:
    """Return whether a pod's spec keeps it forever on a machine that Kubernetes cannot reach."""
    return any(
        one.get("key") in (STAY[1], None)
        and one.get("operator") == "Exists"
        and one.get("effect") in ("NoExecute", None)
        and one.get("tolerationSeconds") is None
        for one in pod.get("tolerations") or []
    )


def toleration(item: Toleration) -> Object:
    fields = {
        "key": str(item.key) if item.key else None,
        "operator": item.operator or ("Exists" if item.value is None else "Equal"),
        "value": str(item.value) if item.value is not None else None,
        "effect": item.effect,
        "tolerationSeconds": int(item.seconds) if item.seconds is not None else None,
    }
    return drop_empty(fields)

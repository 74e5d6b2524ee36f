"""Which networks a pod requests from Multus, and which of them it got; pure.

A pod that starts while Multus does not run may come up without its second network. Its phase and
readiness do not show that. An annotation shows what Multus has done.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

import attrs

from rigel_k8s.network.wiring import NETWORK_STATUS_ANNOTATION, NETWORKS_ANNOTATION

Pod = Mapping[str, Any]


@attrs.frozen
class Missing:
    """A running pod without networks that it requests, each NAMESPACE/NAME."""

    namespace: str
    pod: str
    node: str
    networks: tuple[str, ...]

    def __str__(self) -> str:
        names = ", ".join(self.networks)
        return f"pod {self.namespace}/{self.pod} on {self.node} runs without its network {names}"


def find_without_interface(pods: Iterable[Pod]) -> list[Missing]:
    """Return the running pods without a network that they request; a restart gives it to them."""
    return [missing for pod in pods if (missing := _find_missing(pod))]


def list_asked(pod: Pod) -> list[str]:
    """Return the networks that a pod requests, NAMESPACE/NAME, one for each interface."""
    text = _annotations(pod).get(NETWORKS_ANNOTATION, "").strip()
    own = pod["metadata"].get("namespace", "default")
    if text.startswith("["):
        entries = [entry for entry in _list(text) if isinstance(entry, dict)]
        return [f"{entry.get('namespace') or own}/{entry.get('name', '')}" for entry in entries]
    names = [part.strip().partition("@")[0] for part in text.split(",")]
    return [name if "/" in name else f"{own}/{name}" for name in names if name]


def list_attached(pod: Pod) -> list[str]:
    """Return the networks that a pod got beside its cluster's own, NAMESPACE/NAME."""
    status = _list(_annotations(pod).get(NETWORK_STATUS_ANNOTATION, ""))
    entries = [entry for entry in status if isinstance(entry, dict)]
    return [str(entry.get("name", "")) for entry in entries if not entry.get("default")]


def _find_missing(pod: Pod) -> Missing | None:
    meta, spec = pod["metadata"], pod.get("spec", {})
    running = pod.get("status", {}).get("phase") == "Running"
    if not running or meta.get("deletionTimestamp"):
        return None
    left = list_attached(pod)
    missing = []
    for name in list_asked(pod):
        if name in left:
            left.remove(name)
        else:
            missing.append(name)
    if not missing:
        return None
    namespace = meta.get("namespace", "default")
    return Missing(namespace, meta["name"], spec.get("nodeName", ""), tuple(missing))


def _annotations(pod: Pod) -> Mapping[str, str]:
    found: Mapping[str, str] = pod["metadata"].get("annotations") or {}
    return found


def _list(text: str) -> list[Any]:
    try:
        found = json.loads(text or "[]")
    except ValueError:
        return []
    return found if isinstance(found, list) else []

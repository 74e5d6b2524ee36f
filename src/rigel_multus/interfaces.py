"""Which networks a pod requests from Multus, and which of them it got; pure.

A pod that starts while Multus does not run may come up without its second network. Its phase and
readiness do not show that. An annotation shows what Multus has done.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import attrs

from rigel_k8s.network.wiring import NETWORK_STATUS_ANNOTATION, NETWORKS_ANNOTATION
from rigel_k8s.objects.overlay import list_mappings, parse_json

Pod = Mapping[str, Any]


@attrs.frozen
class InterfaceRequest:
    """A network that a pod requests, NAMESPACE/NAME, and its addresses if it requests them."""

    key: str
    addresses: tuple[str, ...] = ()


@attrs.frozen
class UnattachedPod:
    """A running pod without networks that it requests, each NAMESPACE/NAME."""

    namespace: str
    pod: str
    node: str
    networks: tuple[str, ...]

    def __str__(self) -> str:
        names = ", ".join(self.networks)
        return f"pod {self.namespace}/{self.pod} on {self.node} runs without its network {names}"


def list_requests(annotations: Mapping[str, str], namespace: str) -> list[InterfaceRequest]:
    """Return what a pod of a namespace requests, one for each interface."""
    text = (annotations.get(NETWORKS_ANNOTATION) or "").strip()
    if text.startswith("["):
        requests = []
        for entry in list_entries(text):
            key = f"{entry.get('namespace') or namespace}/{entry.get('name', '')}"
            requests.append(InterfaceRequest(key, tuple(map(str, entry.get("ips") or []))))
        return requests
    names = [part.strip().partition("@")[0] for part in text.split(",")]
    return [
        InterfaceRequest(name if "/" in name else f"{namespace}/{name}") for name in names if name
    ]


def requests_of(pod: Pod) -> list[InterfaceRequest]:
    meta = pod["metadata"]
    return list_requests(meta.get("annotations") or {}, meta.get("namespace", "default"))


def find_without_interface(pods: Iterable[Pod]) -> list[UnattachedPod]:
    """Return the running pods without a network that they request; a restart gives it to them."""
    found = []
    for pod in pods:
        meta = pod["metadata"]
        running = pod.get("status", {}).get("phase") == "Running"
        if not running or meta.get("deletionTimestamp"):
            continue
        status = (meta.get("annotations") or {}).get(NETWORK_STATUS_ANNOTATION)
        left = [str(e.get("name", "")) for e in list_entries(status) if not e.get("default")]
        missing = []
        for request in requests_of(pod):
            if request.key in left:
                left.remove(request.key)
            else:
                missing.append(request.key)
        if missing:
            node = pod.get("spec", {}).get("nodeName", "")
            namespace = meta.get("namespace", "default")
            found.append(UnattachedPod(namespace, meta["name"], node, tuple(missing)))
    return found


def list_entries(text: str | None) -> list[Mapping[str, Any]]:
    """Return the mappings in a list as JSON, none if it is invalid."""
    listed: list[Any] = parse_json(text, [])
    return list(list_mappings(listed))

"""What a release requests of the second network: its pods, attachments, possible machines."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.network.preflight.attachments import address
from rigel_k8s.network.preflight.machine import Address
from rigel_k8s.network.wiring import NETWORKS_ANNOTATION

Manifest = Mapping[str, Any]


@attrs.frozen
class Request:
    """One attachment that a pod requests: NAMESPACE/NAME, and addresses if it requests them."""

    key: str
    addresses: tuple[Address, ...] = ()


@attrs.frozen
class Wanted:
    """A workload whose pods request second networks.

    Attributes:
        pods: how many of them.
        labels: of the pods, for policies that select them.
        spec: the pods' spec, which decides where they may run.
    """

    workload: str
    namespace: str
    requests: tuple[Request, ...]
    pods: int = 1
    labels: Mapping[str, str] = attrs.field(factory=dict)
    spec: Manifest = attrs.field(factory=dict)

    def requests_network(self, key: str) -> bool:
        """Return whether its pods request this attachment."""
        return any(request.key == key for request in self.requests)


def find_wanted(objects: Iterable[Manifest]) -> Iterator[Wanted]:
    """Yield the workloads that request an attachment, or the machine's own network."""
    for item in objects:
        spec = item.get("spec") or {}
        template = spec.get("template") or {}
        meta, pod = template.get("metadata") or {}, template.get("spec") or {}
        namespace = item["metadata"].get("namespace", "")
        asked = tuple(requests(meta.get("annotations") or {}, namespace))
        if asked or pod.get("hostNetwork"):
            replicas = spec.get("replicas")
            yield Wanted(
                item["metadata"]["name"],
                namespace,
                asked,
                pods=1 if replicas is None else int(replicas),
                labels=meta.get("labels") or {},
                spec=pod,
            )


def requests(annotations: Mapping[str, str], namespace: str) -> Iterator[Request]:
    """Yield the requests in a pod's annotation, in either of its forms."""
    text = (annotations.get(NETWORKS_ANNOTATION) or "").strip()
    if not text.startswith("["):
        for word in filter(None, (part.strip() for part in text.split(","))):
            yield Request(_key(word.partition("@")[0], namespace))
        return
    for item in _items(text):
        found = [address(one) for one in item.get("ips") or []]
        own = str(item.get("namespace") or namespace)
        addresses = tuple(one for one in found if one is not None)
        yield Request(_key(str(item.get("name", "")), own), addresses)


def _key(name: str, namespace: str) -> str:
    return name if "/" in name else f"{namespace}/{name}"


def _items(text: str) -> list[Mapping[str, Any]]:
    try:
        read = json.loads(text)
    except ValueError:
        return []
    return [item for item in read if isinstance(item, dict)]

"""Which images a release runs, and pinning them by digest; plain data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from rigel_k8s.objects.refs import Manifest

__all__ = ["images_of", "pinned"]


def images_of(objects: Iterable[Manifest]) -> tuple[str, ...]:
    """Return the images of all workloads, each once."""
    found = (c["image"] for item in objects for c in containers(item) if c.get("image"))
    return tuple(dict.fromkeys(found))


def containers(manifest: Manifest) -> Iterator[dict[str, Any]]:
    """Yield the containers of a workload's pods."""
    spec = manifest.get("spec", {}).get("template", {}).get("spec", {})
    for kind in ("initContainers", "containers"):
        yield from spec.get(kind) or ()


def pinned(manifest: dict[str, Any], digests: Mapping[str, str]) -> dict[str, Any]:
    """Give a workload's containers the images by digest where one is known; return it."""
    for container in containers(manifest):
        if container.get("image") in digests:
            container["image"] = digests[container["image"]]
    return manifest

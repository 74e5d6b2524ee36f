"""Which images a release runs, pinning them by digest, and who may pull them; plain data."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.objects.overlay import simplify
from rigel_k8s.objects.refs import Manifest


def images_of(objects: Iterable[Manifest]) -> tuple[str, ...]:
    """Return the images of all workloads, each once."""
    found = (c["image"] for item in objects for c in containers(item) if c.get("image"))
    return tuple(dict.fromkeys(found))


def containers(manifest: Manifest) -> Iterator[dict[str, Any]]:
    """Yield the containers of a workload's pods."""
    spec = manifest.get("spec", {}).get("template", {}).get("spec", {})
    for kind in ("initContainers", "containers"):
        yield from spec.get(kind) or ()


def list_loaded(nodes: Iterable[Manifest]) -> frozenset[str]:
    """Return the images that nodes report to have, by tag (NAME:TAG) and by digest (NAME@DIGEST).

    A kubelet reports its fifty largest.
    """
    images = (image for node in nodes for image in node.get("status", {}).get("images") or ())
    return frozenset(name for image in images for name in image.get("names") or ())


def pin_images(manifest: Manifest, digests: Mapping[str, str]) -> Manifest:
    """Return a workload with its images by digest where one is known; else the object as it is."""
    if not any(container.get("image") in digests for container in containers(manifest)):
        return manifest
    result: dict[str, Any] = simplify(manifest)
    for container in containers(result):
        container["image"] = digests.get(container["image"], container["image"])
    return result


def add_pull_secrets(manifest: Manifest, secrets: Sequence[str]) -> Manifest:
    """Return a workload whose pods may pull with some Secrets too; else the object as it is."""
    if not secrets or not any(True for _ in containers(manifest)):
        return manifest
    result: dict[str, Any] = simplify(manifest)
    spec = result["spec"]["template"]["spec"]
    named = [*(one["name"] for one in spec.get("imagePullSecrets") or ()), *secrets]
    spec["imagePullSecrets"] = [{"name": name} for name in dict.fromkeys(named)]
    return result

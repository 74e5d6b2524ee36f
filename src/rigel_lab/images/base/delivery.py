"""The way of a built image to its user: a container engine, or a registry."""

from __future__ import annotations

from rigel_k8s.image_reference import parse_reference
from rigel_k8s.report import Reporter
from rigel_lab.cluster import registries
from rigel_lab.cluster.oci import push_archive
from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.base.engine import forget, load, push


def deliver(image: BaseImage, target: str | None, report: Reporter) -> str:
    """Push an image under a name, or load it into podman or docker; return its name there."""
    if target is None:
        load(image, report)
        return image.reference
    name = parse_reference(target)
    if name.registry in registries():
        push_archive(image.archive, f"{name.repository}:{name.version}", name.registry)
        forget(target)  # an earlier cluster at this address may have had another image
        report.progress(target, "pushed", done=True)
    else:
        push(image, target, report)
    return target

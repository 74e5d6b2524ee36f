"""image: the ROS 1 base image, built, loaded and pushed."""

from __future__ import annotations

from rigel_k8s import localcluster
from rigel_k8s.images import ros1base
from rigel_k8s.sequences.job import Reporter

__all__ = ["ros1_base"]


def ros1_base(report: Reporter, *, variant: ros1base.Variant, push: str | None, force: bool) -> str:
    """Build (once) the base image, load it into podman or docker, push it; return its name."""
    image = ros1base.build(report, variant=variant, force=force)
    if push is None:
        ros1base.load(image, report)
        return image.reference
    registry = push.split("/", 1)[0]
    ros1base.push(image, push, report, plain_http=registry in localcluster.registries())
    return push

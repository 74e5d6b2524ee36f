"""image: the ROS 1 base image, built and pushed."""

from __future__ import annotations

from rigel_k8s.images import ros1base
from rigel_k8s.sequences.job import Reporter

__all__ = ["ros1_base"]


def ros1_base(report: Reporter, *, variant: str, push: str | None, force: bool) -> str:
    """Build (once) the base image, load it into podman or docker, push it; return its name."""
    image = ros1base.build(report, variant=variant, force=force)
    engine = ros1base.load(image, report)
    if push:
        ros1base.push(image, push, engine, report)
    return push or image.reference

"""image: the project's own images, built, loaded and pushed."""

from __future__ import annotations

from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.lab import BaseImage, exporter, load_image, push_image, ros1base, ros2base
from rigel_k8s.lab import cluster as localcluster

__all__ = ["ros1_base", "ros2_base", "ros_exporter"]


def ros1_base(
    report: JobReporter, *, variant: ros1base.Variant, push: str | None, force: bool
) -> str:
    """Build (once) the base image, load it into podman or docker, push it; return its name."""
    return _deliver(ros1base.build(report, variant=variant, force=force), push, report)


def ros2_base(
    report: JobReporter, *, distro: ros2base.Distro, push: str | None, force: bool
) -> str:
    """Build (once) the base image, load it into podman or docker, push it; return its name."""
    return _deliver(ros2base.build(report, distro=distro, force=force), push, report)


def ros_exporter(report: JobReporter, *, push: str | None, force: bool) -> str:
    """Build (once) the image, load it into podman or docker, push it; return its name."""
    return _deliver(exporter.build(report, force=force), push, report)


def _deliver(image: BaseImage, push: str | None, report: JobReporter) -> str:
    if push is None:
        load_image(image, report)
        return image.reference
    registry = push.split("/", 1)[0]
    push_image(image, push, report, plain_http=registry in localcluster.registries())
    return push

"""image: the project's own images, built, loaded and pushed."""

from __future__ import annotations

from rigel_k8s import lab
from rigel_k8s.image_reference import parse_reference
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.lab import (
    BaseImage,
    exporter,
    forget_image,
    load_image,
    mutoagent,
    push_archive,
    push_image,
    ros1base,
    ros2base,
)


def ros1_base(
    report: JobReporter, *, variant: ros1base.Variant, push: str | None, force: bool
) -> str:
    """Build (once) the base image; load it into podman or docker, or push it; return its name."""
    return _deliver(ros1base.build(report, variant=variant, force=force), push, report)


def ros2_base(
    report: JobReporter, *, distro: ros2base.Distro, push: str | None, force: bool
) -> str:
    """Build (once) the base image; load it into podman or docker, or push it; return its name."""
    return _deliver(ros2base.build(report, distro=distro, force=force), push, report)


def ros_exporter(report: JobReporter, *, push: str | None, force: bool) -> str:
    """Build (once) the image; load it into podman or docker, or push it; return its name."""
    return _deliver(exporter.build(report, force=force), push, report)


def muto_agent(report: JobReporter, *, push: str | None, force: bool) -> str:
    """Build (once) the image; load it into podman or docker, or push it; return its name."""
    return _deliver(mutoagent.build(report, force=force), push, report)


def _deliver(image: BaseImage, push: str | None, report: JobReporter) -> str:
    if push is None:
        load_image(image, report)
        return image.reference
    name = parse_reference(push)
    if name.registry in lab.cluster.registries():
        push_archive(image.archive, f"{name.repository}:{name.version}", name.registry)
        forget_image(push)  # an earlier cluster at this address may have had another image
        report.progress(push, "pushed", done=True)
    else:
        push_image(image, push, report)
    return push

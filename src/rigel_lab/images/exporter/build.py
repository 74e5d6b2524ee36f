"""The recipe of the exporter's image."""

from __future__ import annotations

from rigel_k8s.report import Reporter
from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.program import ProgramImage
from rigel_lab.images.exporter.program import entries

IMAGE = ProgramImage(
    name="ros-exporter",
    title="ROS exporter's image",
    module="rigel_exporter",
    arguments=["/etc/ros-exporter/config.json"],
)
REFERENCE, UPSTREAM = IMAGE.reference, IMAGE.upstream


def build(report: Reporter, *, arch: str | None = None, force: bool = False) -> BaseImage:
    """Return the image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        arch: the architecture of its programs (`arm64`); None: that of this machine.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap is missing and cannot be installed here.
        CommandFailed: mmdebstrap failed.
    """
    return build_recipe(IMAGE.make_recipe(entries(), arch=arch), report, force=force)

"""The recipe of the ROS 2 base image: Debian, the wheels, and the official image's paths."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import architecture, layer
from rigel_lab.images.base.build import EPOCH, BaseImage, Recipe
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.layer import config
from rigel_lab.images.ros2base import overlay, wheels
from rigel_lab.images.ros2base.packages import PACKAGES, PLATFORM, REFERENCES, SUITE, Distro, lock


def build(report: Reporter, *, distro: Distro = "jazzy", force: bool = False) -> BaseImage:
    """Return the base image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        distro: the ROS 2 distribution.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap or pip is missing, or no wheels exist for this processor.
        CommandFailed: mmdebstrap or pip failed.
    """
    if architecture() != "amd64":
        raise RigelK8sError(
            f"there are no wheels of ROS 2 for {architecture()}, only for {PLATFORM}",
            hint="build the image on an amd64 machine, or use the official one if you can reach it",
        )
    return build_recipe(_recipe(distro), report, force=force)


def _recipe(distro: Distro) -> Recipe:
    def prepare(scratch: Path, report: Reporter) -> Sequence[str]:
        fetched = wheels.fetch(lock(distro), scratch / "wheels", report)
        ros = scratch / "ros.tar"
        wheels.tree(fetched, overlay.prefix(distro), ros, mtime=EPOCH)
        return _hooks(ros, f"/{overlay.prefix(distro)}/{wheels.SITE}")

    return Recipe(
        title="ROS 2 base image",
        family="ros2-base",
        name=distro,
        reference=REFERENCES[distro],
        suite=SUITE,
        packages=PACKAGES,
        config=config(distro),
        overlay=layer(overlay.entries(distro), mtime=EPOCH),
        locked=lock(distro).encode(),
        prepare=prepare,
    )


def _hooks(ros: Path, modules: str) -> tuple[str, ...]:
    """Put ROS in, its modules compiled: pods start with a read-only or an empty cache."""
    compiled = f"python3 -m compileall -q --invalidation-mode checked-hash {modules}"
    return (
        f"--customize-hook=tar-in {ros} /",
        f'--customize-hook=chroot "$1" {compiled}',
    )

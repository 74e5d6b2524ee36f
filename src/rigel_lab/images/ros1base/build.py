"""The recipe of the ROS 1 base image: Debian's packages and the official image's paths."""

from __future__ import annotations

from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import architecture
from rigel_lab.images.base.build import EPOCH, BaseImage, Recipe
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.ros1base import overlay
from rigel_lab.images.ros1base.packages import PACKAGES, REFERENCES, SUITE, Variant


def build(
    report: Reporter,
    *,
    variant: Variant = "core",
    arch: str | None = None,
    force: bool = False,
) -> BaseImage:
    """Return the base image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        variant: `core` runs ROS 1 nodes, `devel` also compiles C++ workspaces.
        arch: the architecture of its programs (`arm64`); None: that of this machine.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap is missing and cannot be installed here.
        CommandFailed: mmdebstrap failed.
    """
    recipe = Recipe(
        title="ROS 1 base image",
        family="ros1-base",
        name=variant,
        reference=REFERENCES[variant],
        suite=SUITE,
        packages=PACKAGES[variant],
        config=overlay.CONFIG,
        overlay=overlay.layer(variant, mtime=EPOCH),
        arch=arch or architecture(),
    )
    return build_recipe(recipe, report, force=force)

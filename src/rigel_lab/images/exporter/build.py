"""The recipe of the exporter's image."""

from __future__ import annotations

from rigel_k8s import __version__
from rigel_k8s.report import Reporter
from rigel_k8s.system.oci import layer
from rigel_lab.images.base.bootstrap import EXTRACT
from rigel_lab.images.base.build import EPOCH, BaseImage, Recipe
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.exporter.program import PREFIX, entries

SUITE = "bookworm"
#: The name that podman and docker give it when they load it, and the one that pods use.
REFERENCE = f"localhost/rigel-k8s/ros-exporter:{__version__}"
UPSTREAM = f"ghcr.io/rigel-k8s/ros-exporter:{__version__}"

PACKAGES = ("python3",)

CONFIG = {
    "Entrypoint": ["/usr/bin/python3", "-m", "rigel_k8s.exporter"],
    "Cmd": ["/etc/ros-exporter/config.json"],
    "Env": [
        "PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin",
        "LANG=C.UTF-8",
        f"PYTHONPATH=/{PREFIX}",
        "PYTHONDONTWRITEBYTECODE=1",
        "PYTHONUNBUFFERED=1",
    ],
    "User": "65532:65532",
}


def build(report: Reporter, *, force: bool = False) -> BaseImage:
    """Return the image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap is missing and cannot be installed here.
        CommandFailed: mmdebstrap failed.
    """
    recipe = Recipe(
        title="ROS exporter's image",
        family="ros-exporter",
        name="python",
        reference=REFERENCE,
        suite=SUITE,
        packages=PACKAGES,
        config=CONFIG,
        overlay=layer(entries(), mtime=EPOCH),
        variant=EXTRACT,
    )
    return build_recipe(recipe, report, force=force)

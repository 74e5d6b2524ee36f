"""The way from nothing to the base image's archive, and the cache that spares it."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import time
from pathlib import Path

import attrs

from rigel_k8s.images.ros1base import archive, overlay
from rigel_k8s.images.ros1base.bootstrap import bootstrap
from rigel_k8s.images.ros1base.packages import PACKAGES, REFERENCES, SUITE, Variant
from rigel_k8s.report import Reporter

__all__ = ["BaseImage", "build", "cache_directory"]

#: Every file's time in the image, so that a build of the same packages is the same image.
_EPOCH = 1704067200


@attrs.frozen
class BaseImage:
    """The archive of a base image.

    Attributes:
        reference: the name that podman and docker give it when they load it.
        archive: the file to load: `podman load -i`, `docker load -i`, `ctr images import`.
        built: whether this call built it; otherwise it was in the cache.
    """

    reference: str
    archive: Path
    built: bool


def build(report: Reporter, *, variant: Variant = "core", force: bool = False) -> BaseImage:
    """Return the base image's archive; build it where the cache lacks it.

    Args:
        report: where to tell what happens.
        variant: `core` runs ROS 1 nodes, `devel` also compiles C++ workspaces.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap is missing and cannot be installed here.
        CommandFailed: mmdebstrap failed.
    """
    reference = REFERENCES[variant]
    target = cache_directory() / f"{variant}-{_key(variant)}.tar"
    if target.exists() and not force:
        report.line(f"ROS 1 base image {reference} is up to date ({target})")
        return BaseImage(reference, target, built=False)
    started = time.monotonic()
    report.line(f"building the ROS 1 base image {reference} from Debian {SUITE}'s packages")
    target.parent.mkdir(parents=True, exist_ok=True)
    _build(variant, target, report)
    size = target.stat().st_size / 1e6
    report.line(f"built {target} ({size:.0f} MB) in {time.monotonic() - started:.0f} s")
    return BaseImage(reference, target, built=True)


def cache_directory() -> Path:
    """Return where archives are kept."""
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "rigel-k8s" / "ros1-base"


def _build(variant: Variant, target: Path, report: Reporter) -> None:
    with tempfile.TemporaryDirectory(prefix="build-", dir=target.parent) as scratch:
        debian = Path(scratch) / "debian.tar"
        bootstrap(SUITE, PACKAGES[variant], debian, report, mtime=_EPOCH)
        own = Path(scratch) / "overlay.tar"
        own.write_bytes(overlay.layer(variant, mtime=_EPOCH))
        report.progress("archive", "writing")
        archive.write(target, [debian, own], overlay.CONFIG, REFERENCES[variant], created=_EPOCH)
        report.progress("archive", "done", done=True)


def _key(variant: Variant) -> str:
    """What the archive is made of, as a short digest: another recipe is another file."""
    recipe = [archive.FORMAT, archive.architecture(), SUITE, *PACKAGES[variant]]
    recipe.append(json.dumps(overlay.CONFIG))
    found = hashlib.sha256("\n".join(recipe).encode())
    found.update(overlay.layer(variant, mtime=_EPOCH))
    return found.hexdigest()[:16]

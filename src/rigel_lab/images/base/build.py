"""From a recipe to a base image's archive, and the cache that saves the build."""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import attrs

from rigel_k8s.report import Reporter
from rigel_k8s.system import oci
from rigel_k8s.system.cache import cache_dir, locked
from rigel_lab.images.base.bootstrap import MINBASE, RECORD, bootstrap

#: Every file's time in an image, so that a build of the same packages is the same image.
EPOCH = 1704067200


def prepare_nothing(_: Path, __: Reporter) -> tuple[str, ...]:
    """Return no hooks, for an image with Debian's packages alone."""
    return ()


@attrs.frozen
class Recipe:
    """The parts of a base image.

    Attributes:
        title: its name, for people: `ROS 1 base image`.
        family: the directory in the cache.
        name: the archive's name there, before its digest.
        reference: the name that podman and docker give the image when they load it.
        suite: the Debian release.
        packages: its packages.
        config: the `config` of an OCI image configuration.
        overlay: the upper layer, an uncompressed tar.
        locked: what else decides about the content: versions and digests.
        prepare: gets a scratch directory, fetches there what is not a Debian package, and returns
            mmdebstrap's hooks that put it in.
        variant: mmdebstrap's, as in bootstrap.
        arch: the architecture of its programs, as images and Debian have it.
    """

    title: str
    family: str
    name: str
    reference: str
    suite: str
    packages: Sequence[str]
    config: Mapping[str, str | Sequence[str]]
    overlay: bytes
    locked: bytes = b""
    prepare: Callable[[Path, Reporter], Sequence[str]] = prepare_nothing
    variant: str = MINBASE
    arch: str = attrs.field(factory=oci.architecture)


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


def build(recipe: Recipe, report: Reporter, *, force: bool = False) -> BaseImage:
    """Return the recipe's archive; build it if the cache does not have it.

    Args:
        recipe: what it is made of.
        report: shows the progress.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap is missing and cannot be installed here.
        CommandFailed: mmdebstrap, or a program that fetches, failed.
    """
    target = cache_dir() / recipe.family / f"{recipe.name}-{_key(recipe)}.tar"
    with locked(target.with_suffix(".lock")):  # other processes wait for the one that builds it
        if built := force or not target.exists():
            _build(recipe, target, report)
        else:
            report.line(f"{recipe.title} {recipe.reference} is up to date ({target})")
    return BaseImage(recipe.reference, target, built=built)


def _build(recipe: Recipe, target: Path, report: Reporter) -> None:
    started = time.monotonic()
    report.line(f"building the {recipe.title} {recipe.reference} (Debian {recipe.suite})")
    with tempfile.TemporaryDirectory(prefix="build-", dir=target.parent) as scratch:
        hooks = recipe.prepare(Path(scratch), report)
        debian = Path(scratch) / "debian.tar"
        bootstrap(
            recipe.suite,
            recipe.packages,
            debian,
            report,
            mtime=EPOCH,
            hooks=hooks,
            variant=recipe.variant,
            arch=recipe.arch,
        )
        own = Path(scratch) / "overlay.tar"
        own.write_bytes(recipe.overlay)
        report.progress("archive", "writing")
        oci.write_archive(
            target,
            [debian, own],
            recipe.config,
            recipe.reference,
            created=EPOCH,
            arch=recipe.arch,
        )
        report.progress("archive", "done", done=True)
    size = target.stat().st_size / 1e6
    report.line(f"built {target} ({size:.0f} MB) in {time.monotonic() - started:.0f} s")


def _key(recipe: Recipe) -> str:
    """The parts of the archive, as a short digest: another recipe is another file."""
    lines = [oci.FORMAT, recipe.arch, recipe.suite, *recipe.packages]
    lines.append(json.dumps(recipe.config))
    if recipe.variant != MINBASE:
        lines += [recipe.variant, RECORD]
    found = hashlib.sha256("\n".join(lines).encode())
    found.update(recipe.overlay)
    found.update(recipe.locked)
    return found.hexdigest()[:16]

"""The way of a built image to its user: podman or docker, or a registry."""

from __future__ import annotations

import shutil

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.image_reference import parse_reference
from rigel_k8s.report import Reporter
from rigel_k8s.system.process import run, succeeds
from rigel_lab.cluster import registries
from rigel_lab.cluster.oci import push_archive
from rigel_lab.images.base.build import BaseImage


def deliver(image: BaseImage, target: str | None, report: Reporter) -> str:
    """Push an image under a name, or load it into podman or docker; return its name there.

    Raises:
        RigelK8sError: neither is installed.
        CommandFailed: the engine or the registry refused it.
    """
    if target is None:
        load(image, report)
        return image.reference
    name = parse_reference(target)
    if name.registry in registries():
        push_archive(image.archive, f"{name.repository}:{name.version}", name.registry)
        forget(target)  # an earlier cluster at this address may have had another image
    else:
        engine = load(image, report)
        report.progress(target, "pushing")
        _call([engine, "tag", image.reference, target])
        _call([engine, "push", target])
    report.progress(target, "pushed", done=True)
    return target


def load(image: BaseImage, report: Reporter) -> str:
    """Load an image into podman, or into docker where that is not installed; return which."""
    engine = next(filter(shutil.which, ("podman", "docker")), None)
    if engine is None:
        raise RigelK8sError(
            "neither podman nor docker is installed, so the base image cannot be loaded",
            hint="install one (Debian: sudo apt-get install podman) and retry",
        )
    report.progress(image.reference, f"loading into {engine}")
    _call([engine, "load", "--input", str(image.archive)])
    report.progress(image.reference, f"loaded into {engine}", done=True)
    return engine


def forget(reference: str) -> None:
    """Remove a name from the engines' images, so that a build FROM it pulls its present image.

    The images stay, and an engine without the name is left alone.
    """
    for program, words in (("podman", ["untag", reference]), ("docker", ["rmi", reference])):
        if shutil.which(program):
            succeeds([program, *words])


def _call(command: list[str]) -> None:
    run(command, what=f"`{' '.join(command)}`", hint="run it by hand to see all of its output")

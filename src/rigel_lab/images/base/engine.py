"""The archive into podman or docker, whichever is installed, and from there into a registry."""

from __future__ import annotations

import shutil

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.report import Reporter
from rigel_k8s.system.process import run, succeeds
from rigel_lab.images.base.build import BaseImage


def load(image: BaseImage, report: Reporter, *, engine: str | None = None) -> str:
    """Load the image into a container engine and return that engine's name.

    Args:
        image: what to load.
        report: shows the progress.
        engine: `podman` or `docker`; None takes the first that is installed, podman before docker.

    Raises:
        RigelK8sError: neither is installed.
        CommandFailed: the engine refused the archive.
    """
    program = engine or _find_engine()
    report.progress(image.reference, f"loading into {program}")
    _run([program, "load", "--input", str(image.archive)])
    report.progress(image.reference, f"loaded into {program}", done=True)
    return program


def push(
    image: BaseImage,
    reference: str,
    report: Reporter,
    *,
    engine: str | None = None,
) -> None:
    """Load the image, name it `reference` and push it there.

    Args:
        image: what to push.
        reference: registry, path and tag.
        report: shows the progress.
        engine: as in `load`.

    Raises:
        RigelK8sError: no engine is installed.
        CommandFailed: the registry or the engine refused.
    """
    program = load(image, report, engine=engine)
    report.progress(reference, "pushing")
    _run([program, "tag", image.reference, reference])
    _run([program, "push", reference])
    report.progress(reference, "pushed", done=True)


def forget(reference: str) -> None:
    """Remove a name from the engines' images, so that a build FROM it pulls its present image.

    The images stay, and an engine without the name is left alone.
    """
    for program, words in (("podman", ["untag", reference]), ("docker", ["rmi", reference])):
        if shutil.which(program):
            succeeds([program, *words])


def _run(command: list[str]) -> None:
    run(command, what=f"`{' '.join(command)}`", hint="run it by hand to see all of its output")


def _find_engine() -> str:
    for program in ("podman", "docker"):
        if shutil.which(program):
            return program
    raise RigelK8sError(
        "neither podman nor docker is installed, so the base image cannot be loaded",
        hint="install one (Debian: sudo apt-get install podman) and retry",
    )
